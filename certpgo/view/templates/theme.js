(function () {
  "use strict";
  const names = ["system", "light", "dark"];
  const button = document.getElementById("theme");
  const read = () => { try { return localStorage.getItem("theme"); } catch (error) { return null; } };
  const keep = (name) => { try { localStorage.setItem("theme", name); } catch (error) { /* not allowed here */ } };
  function paint(name) {
    if (name === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    document.dispatchEvent(new Event("themechange"));
  }
  function apply(name) {
    button.textContent = "Theme: " + name;
    button.dataset.name = name;
    paint(name);
  }
  button.hidden = false;
  button.addEventListener("click", () => {
    const name = names[(names.indexOf(button.dataset.name) + 1) % names.length];
    keep(name);
    apply(name);
  });
  // Print on white, including what scripts have drawn.
  window.addEventListener("beforeprint", () => paint("light"));
  window.addEventListener("afterprint", () => paint(button.dataset.name));
  if (location.hash === "#scene") document.documentElement.classList.add("framed");
  apply(names.includes(read()) ? read() : "system");
})();
