// The register's table: a click on a title sorts by that column, and a word filters the rows.
document.addEventListener("DOMContentLoaded", () => {
  const table = document.querySelector("table.optima");
  if (!table) return;
  const body = table.tBodies[0];
  const key = (row, column) => row.cells[column].dataset.key ?? row.cells[column].textContent;
  const compared = (a, b) => (isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b);
  table.querySelectorAll("th button").forEach((button) => {
    button.addEventListener("click", () => {
      const column = button.parentElement.cellIndex;
      const down = button.parentElement.getAttribute("aria-sort") === "ascending";
      table.querySelectorAll("th").forEach((other) => other.removeAttribute("aria-sort"));
      button.parentElement.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows].sort((a, b) => compared(key(a, column), key(b, column)));
      body.append(...(down ? rows.reverse() : rows));
    });
  });
  document.getElementById("optima-filter").addEventListener("input", (event) => {
    const words = event.target.value.toLowerCase().split(/\s+/);
    for (const row of body.rows) {
      row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
    }
  });
});
