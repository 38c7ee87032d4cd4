// A view of points and edges with an orthographic camera: rotate, pan and zoom.
const Scene = (function () {
  "use strict";

  // Viridis, sampled; distinguishable with any colour blindness.
  const STOPS = [
    [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
    [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37],
  ];
  const COLOURS = 32;
  // Share of the canvas that is filled.
  const MARGIN = 0.94;
  // Height of the strip below the scene that has the axes and the scale, pixels.
  const STRIP = 64;
  // Radius of the ring of a prior, pixels.
  const RING = 4;

  // The colour of a share in 0 ... 1; large residuals stand out on light and dark backgrounds.
  function colour(share, dark) {
    const at = Math.min(Math.max(share, 0), 1);
    const place = (dark ? 0.2 + 0.8 * at : 0.88 * (1 - at)) * (STOPS.length - 1);
    const k = Math.min(Math.floor(place), STOPS.length - 2);
    const mix = (c) => Math.round(STOPS[k][c] + (place - k) * (STOPS[k + 1][c] - STOPS[k][c]));
    return "rgb(" + mix(0) + "," + mix(1) + "," + mix(2) + ")";
  }

  const bucket = (value, top) =>
    top > 0 ? Math.min(COLOURS - 1, Math.max(0, Math.floor((value / top) * COLOURS))) : 0;

  // Rows of the camera's rotation: right, up, towards the viewer.
  function camera(turn, tilt) {
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    return [[c, s, 0], [-s * st, c * st, ct], [s * ct, -c * ct, st]];
  }

  // Centre of the points, half their extents, and the largest distance from the centre.
  function frame(points) {
    const d = points.length ? points[0].length : 2;
    const low = Array(d).fill(Infinity), high = Array(d).fill(-Infinity);
    for (const p of points) {
      for (let k = 0; k < d; k++) {
        low[k] = Math.min(low[k], p[k]);
        high[k] = Math.max(high[k], p[k]);
      }
    }
    const centre = low.map((v, k) => (v + high[k]) / 2);
    const half = low.map((v, k) => (high[k] - v) / 2);
    let radius = 0;
    for (const p of points) radius = Math.max(radius, Math.hypot(...p.map((v, k) => v - centre[k])));
    return { centre: centre, half: half, radius: radius };
  }

  // Half the extent on the screen, right and up, of points seen from somewhere.
  function seenFrom(points, box, view) {
    const flat = project(points, { ...box, seen: [1, 1] }, { ...view, x: 0, y: 0, zoom: 1 }, 2, 2);
    const most = (from) => flat.reduce((m, v, k) => (k % 2 === from ? Math.max(m, Math.abs(v - 1)) : m), 0);
    return [most(0) / MARGIN, most(1) / MARGIN];
  }

  // Pixels per unit at zoom 1: everything is visible, in 3D from any direction, or from where the
  // view starts if that is known.
  function fitted(box, width, height) {
    const [a, b] = box.seen || box.half;
    const across = box.half.length === 3 && !box.seen
      ? Math.min(width, height) / (2 * box.radius)
      : Math.min(width / (2 * a), height / (2 * b));
    return MARGIN * (Number.isFinite(across) ? across : Math.min(width, height) / 2);
  }

  // Points in the frame of the scene's box: right, up, and in space towards the viewer.
  function framed(points, frame) {
    if (!frame) return points;
    return points.map((p) => frame.axes.map((axis) => axis.reduce((sum, a, k) => sum + a * (p[k] - frame.centre[k]), 0)));
  }

  // The longest of 1, 2 or 5 times a power of ten below a length.
  function round(length) {
    const power = Math.pow(10, Math.floor(Math.log10(length)));
    return power * [5, 2, 1].find((k) => k * power <= length * (1 + 1e-9));
  }

  // Screen coordinates of all points, x and y interleaved.
  function project(points, box, view, width, height) {
    const flat = new Float64Array(2 * points.length);
    const size = view.zoom * fitted(box, width, height);
    const [right, up] = camera(view.turn, view.tilt);
    for (let n = 0; n < points.length; n++) {
      const p = points[n];
      let x = p[0] - box.centre[0], y = p[1] - box.centre[1];
      if (p.length === 3) {
        const z = p[2] - box.centre[2];
        [x, y] = [right[0] * x + right[1] * y + right[2] * z, up[0] * x + up[1] * y + up[2] * z];
      }
      flat[2 * n] = width / 2 + view.x + size * x;
      flat[2 * n + 1] = height / 2 + view.y - size * y;
    }
    return flat;
  }

  // How an ellipsoid {x : x^T shape^-1 x <= 1} looks: half its axes and their angle on the screen.
  function outline(shape, frame, view) {
    let axes = frame ? frame.axes : shape.map((_, k) => shape.map((_, l) => (k === l ? 1 : 0)));
    if (shape.length === 3) {
      const seen = camera(view.turn, view.tilt).slice(0, 2);
      axes = seen.map((row) => axes[0].map((_, k) => row.reduce((sum, a, l) => sum + a * axes[l][k], 0)));
    }
    const form = (u, v) => u.reduce((sum, a, k) => sum + a * v.reduce((s, b, l) => s + shape[k][l] * b, 0), 0);
    const [right, up] = axes, a = form(right, right), b = form(right, up), c = form(up, up);
    const mean = (a + c) / 2, half = Math.hypot((a - c) / 2, b);
    return [Math.sqrt(mean + half), Math.sqrt(Math.max(mean - half, 0)), -Math.atan2(2 * b, a - c) / 2];
  }

  // Distance of a point to a line segment.
  function distance(x, y, ax, ay, bx, by) {
    const dx = bx - ax, dy = by - ay, length = dx * dx + dy * dy;
    const t = length > 0 ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
    return Math.hypot(x - ax - t * dx, y - ay - t * dy);
  }

  // The edge nearest to a point within a radius; -1 if there is none.
  function nearest(edges, flat, x, y, reach, shown) {
    let best = -1, least = reach;
    for (let e = 0; e < edges.length; e++) {
      if (shown && !shown(e)) continue;
      const a = 2 * edges[e][0], b = 2 * edges[e][1];
      const far = distance(x, y, flat[a], flat[a + 1], flat[b], flat[b + 1]);
      if (far < least) { least = far; best = e; }
    }
    return best;
  }

  // Edges by descending residual.
  const ranking = (values) => values.map((_, e) => e).sort((a, b) => values[b] - values[a] || a - b);

  // Sightings of landmarks, priors, which have no second end, and distances.
  const SIGHTING = 1, PRIOR = 2, RANGE = 3;
  const kind = (data, e) => (data.kinds ? data.kinds[e] : 0);

  function sentence(data, e) {
    const [i, j] = data.edges[e];
    // What an edge does not measure has no residual.
    const measured = data.measures.filter((m) => m.values[e] >= 0);
    const residuals = measured.map((m) => m.values[e] + " " + m.unit).join(", ");
    const between = data.loop[e] ? "loop closure" : "consecutive nodes";
    const what = [between, "landmark seen", "prior", "distance"][kind(data, e)];
    const ends = kind(data, e) === PRIOR ? "at " + data.ids[i] : data.ids[i] + " to " + data.ids[j];
    return "Edge " + data.numbers[e] + ", " + ends + " (" + what + "): residual " + residuals + ".";
  }

  // In a frame, from above: straight above if all is flat.
  function start(data) {
    const solid = data.dimensions === 3, tilt = data.frame ? 0.9 : 0.6;
    return { turn: solid && !data.frame ? 0.6 : 0, tilt: solid && !data.flat ? tilt : Math.PI / 2, zoom: 1, x: 0, y: 0 };
  }

  function show(element) {
    const data = JSON.parse(element.querySelector("script").textContent);
    // JSON has no number for a residual that is not finite.
    const finite = (values) => values.map((v) => (v === null ? Infinity : v));
    for (const m of data.measures) m.values = finite(m.values);
    if (data.before) data.before.values = data.before.values.map(finite);
    const canvas = element.querySelector("canvas"), context = canvas.getContext("2d");
    const status = element.querySelector(".status"), select = element.querySelector(".measure");
    const every = element.querySelector(".every");
    const placements = [data, data.before].map((given) => given && {
      points: framed(given.points, data.frame),
      frusta: (given.frusta || []).map((line) => framed(line, data.frame)).flat(),
    });
    const truth = (data.truth || []).map((line) => framed(line, data.frame)).flat();
    const cloud = framed(data.cloud ? data.cloud.points : [], data.frame);
    const rejected = (data.rejected || []).map((line) => framed(line, data.frame)).flat();
    const clouded = element.querySelector(".cloud"), refused = element.querySelector(".rejected");
    const all = placements[0].points.concat(placements[0].frusta, cloud), box = frame(all);
    if (data.frame) box.seen = seenFrom(all, box, start(data));
    if (data.metric === false) every.checked = true;
    const sure = (data.outlines || []).map((outlines, k) => ({
      ...outlines,
      points: framed(outlines.points, data.frame),
      box: element.querySelectorAll(".outlines")[k],
    }));
    const early = element.querySelector(".before"), known = element.querySelector(".truth");
    // Of the canvas above the strip.
    const tall = () => canvas.clientHeight - (data.metric ? STRIP : 0);
    const shownPlacement = () => placements[early && early.checked ? 1 : 0];
    const seen = element.querySelector(".seen"), landmarks = data.landmarks || [];
    const isSeen = (e) => kind(data, e) === SIGHTING || kind(data, e) === RANGE;
    const consecutive = data.loop.filter((loop, e) => !loop && kind(data, e) === 0).length;
    let view = start(data), flat = null, picked = -1, place = -1, waiting = false;
    if (consecutive === 0) every.parentElement.hidden = true;
    const sightings = data.edges.map((_, e) => e).filter(isSeen);
    if (seen && sightings.length === 0) seen.parentElement.hidden = true;
    const shown = (e) => !isSeen(e) || !seen || seen.checked;

    // Before and after share a scale of colours.
    const measure = () => {
      const k = Number(select.value) || 0, after = data.measures[k];
      return early && early.checked ? { ...after, values: data.before.values[k] } : after;
    };
    const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    // The background's lightness decides, however the theme was chosen.
    const isDark = () => parseInt(style("--paper").slice(1, 3), 16) < 128;

    function stroke(list, paint, thickness) {
      context.beginPath();
      for (const e of list) {
        const a = 2 * data.edges[e][0], b = 2 * data.edges[e][1];
        if (kind(data, e) === PRIOR) {
          context.moveTo(flat[a] + RING, flat[a + 1]);
          context.arc(flat[a], flat[a + 1], RING, 0, 2 * Math.PI);
        } else {
          context.moveTo(flat[a], flat[a + 1]);
          context.lineTo(flat[b], flat[b + 1]);
        }
      }
      context.strokeStyle = paint;
      context.lineWidth = thickness;
      context.stroke();
    }

    function draw() {
      waiting = false;
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.fillStyle = style("--paper");
      context.fillRect(0, 0, width, height);
      const placed = shownPlacement();
      flat = project(placed.points, box, view, width, tall());
      const { values, top } = measure(), dark = isDark();
      const ink = style("--ink"), point = style("--c1");
      const plain = [], faint = [], buckets = Array.from({ length: COLOURS }, () => []);
      for (let e = 0; e < data.edges.length; e++) {
        if (isSeen(e)) faint.push(e);
        else if (values[e] >= 0 && (data.loop[e] || kind(data, e) === PRIOR || every.checked)) buckets[bucket(values[e], top)].push(e);
        else plain.push(e);
      }
      if (cloud.length && clouded.checked) spots(cloud, data.cloud.colours);
      const thin = data.edges.length > 5000 ? 0.7 : 1.2;
      if (!seen || seen.checked) {
        // Many lines one upon another are as dark as a few.
        context.globalAlpha = Math.min(0.3, Math.max(0.03, 150 / faint.length));
        stroke(faint, style("--soft"), 0.6);
        context.globalAlpha = 1;
      }
      if (truth.length && known.checked) segments(truth, style("--c2"), 1);
      // Large residuals last, on top.
      stroke(plain, style(faint.length ? "--ink" : "--edge"), thin);
      buckets.forEach((list, k) => stroke(list, colour((k + 0.5) / COLOURS, dark), thin + 0.2));
      buckets.forEach((list, k) => dot(list, colour((k + 0.5) / COLOURS, dark)));
      if (rejected.length && refused.checked) segments(rejected, style("--bad"), 1);
      if (placed === placements[0]) sure.filter((outlines) => outlines.box.checked).forEach((outlines) => rings(outlines, style("--" + outlines.ink)));
      segments(placed.frusta, style("--c0"), 0.8);
      const r = data.points.length <= 300 ? 2.2 : 1.2;
      const few = data.points.length <= 2000;
      for (let n = 0; n < data.points.length; n++) {
        if (!landmarks[n] && !few) continue;
        context.fillStyle = landmarks[n] ? point : ink;
        context.beginPath();
        if (landmarks[n]) context.arc(flat[2 * n], flat[2 * n + 1], few ? r + 0.6 : 0.9, 0, 2 * Math.PI);
        else context.rect(flat[2 * n] - r / 2, flat[2 * n + 1] - r / 2, r, r);
        context.fill();
      }
      marks(style("--ink"), style("--paper"));
      if (data.metric) ruler(width, height, style("--ink"));
      if (picked >= 0) {
        stroke([picked], style("--paper"), 6);
        stroke([picked], style("--bad"), 3);
      }
    }

    function spots(points, colours) {
      const at = project(points, box, view, canvas.clientWidth, tall());
      for (let k = 0; k < points.length; k++) {
        context.fillStyle = "#" + colours[k];
        context.fillRect(at[2 * k], at[2 * k + 1], 1.5, 1.5);
      }
    }

    // Ellipses around points.
    function rings(outlines, paint) {
      const at = project(outlines.points, box, view, canvas.clientWidth, tall());
      const size = view.zoom * fitted(box, canvas.clientWidth, tall());
      context.strokeStyle = paint;
      context.lineWidth = 1.2;
      outlines.shapes.forEach((shape, k) => {
        const [a, b, angle] = outline(shape, data.frame, view);
        context.beginPath();
        context.ellipse(at[2 * k], at[2 * k + 1], size * a, size * b, angle, 0, 2 * Math.PI);
        context.stroke();
      });
    }

    // Lines between consecutive pairs of points.
    function segments(points, paint, thickness) {
      const at = project(points, box, view, canvas.clientWidth, tall());
      context.beginPath();
      for (let k = 0; k < at.length; k += 4) {
        context.moveTo(at[k], at[k + 1]);
        context.lineTo(at[k + 2], at[k + 3]);
      }
      context.strokeStyle = paint;
      context.lineWidth = thickness;
      context.stroke();
    }

    // Loop closures that are too short to see have a dot.
    function dot(list, paint) {
      context.fillStyle = paint;
      for (const e of list) {
        const a = 2 * data.edges[e][0], b = 2 * data.edges[e][1];
        if (!data.loop[e] || kind(data, e) !== 0 || Math.hypot(flat[a] - flat[b], flat[a + 1] - flat[b + 1]) > 5) continue;
        context.beginPath();
        context.arc((flat[a] + flat[b]) / 2, (flat[a + 1] + flat[b + 1]) / 2, 2.2, 0, 2 * Math.PI);
        context.fill();
      }
    }

    // A name near a point, readable on lines and within the canvas.
    function label(text, x, y, ink, paper) {
      const wide = context.measureText(text).width, width = canvas.clientWidth;
      const left = x + 7 + wide > width ? x - 7 - wide : x + 7;
      context.lineJoin = "round";
      context.lineWidth = 3;
      context.strokeStyle = paper;
      context.strokeText(text, left, y);
      context.fillStyle = ink;
      context.fillText(text, left, y);
    }

    // The first and the last pose, by name; the names apart where the poses are near.
    function marks(ink, paper) {
      context.font = "12px system-ui, sans-serif";
      const ends = data.ends || [], [a, b] = ends.map((n) => [flat[2 * n], flat[2 * n + 1]]);
      const near = b !== undefined && Math.abs(a[0] - b[0]) < 45 && Math.abs(a[1] - b[1]) < 16;
      ends.forEach((n, k) => {
        const x = flat[2 * n], y = flat[2 * n + 1];
        context.beginPath();
        context.arc(x, y, 4, 0, 2 * Math.PI);
        context.fillStyle = k ? paper : ink;
        context.strokeStyle = ink;
        context.lineWidth = 1.5;
        context.fill();
        context.stroke();
        const below = near && (k ? b[1] >= a[1] : a[1] > b[1]);
        label(k ? "end" : "start", x, below ? y + 15 : y - 5, ink, paper);
      });
    }

    // The world's axes, and a bar of a round length.
    function ruler(width, height, ink) {
      const scale = view.zoom * fitted(box, width, tall()), length = round(120 / scale);
      const [x, y] = [data.frame ? 88 : 16, height - 16], [right, up] = camera(view.turn, view.tilt);
      context.strokeStyle = context.fillStyle = ink;
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(x, y - 5);
      context.lineTo(x, y);
      context.lineTo(x + scale * length, y);
      context.lineTo(x + scale * length, y - 5);
      context.stroke();
      context.font = "12px system-ui, sans-serif";
      context.fillText(length + " " + data.length, x + scale * length + 6, y + 1);
      if (!data.frame) return;
      const [ox, oy] = [40, height - 36];
      data.frame.axes[0].forEach((_, k) => {
        const axis = data.frame.axes.map((row) => row[k]);
        const dot = (row) => axis.reduce((sum, a, i) => sum + a * row[i], 0);
        const [dx, dy] = axis.length === 3 ? [dot(right), dot(up)] : axis;
        context.lineWidth = 1.5;
        context.strokeStyle = context.fillStyle = style(["--bad", "--good", "--link"][k]);
        context.beginPath();
        context.moveTo(ox, oy);
        context.lineTo(ox + 20 * dx, oy - 20 * dy);
        context.stroke();
        if (Math.hypot(dx, dy) > 0.2) context.fillText("xyz"[k], ox + 27 * dx - 3, oy - 27 * dy + 4);
      });
    }

    function legend() {
      const scale = element.querySelector(".scale"), paint = scale.getContext("2d"), dark = isDark();
      for (let x = 0; x < scale.width; x++) {
        paint.fillStyle = colour((Math.floor((x / scale.width) * COLOURS) + 0.5) / COLOURS, dark);
        paint.fillRect(x, 0, 1, scale.height);
      }
      const { values, top, unit } = measure();
      const beyond = values.some((value) => value > top) ? " or more" : "";
      element.querySelector(".high").textContent = top + " " + unit + beyond;
    }

    function redraw() {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(draw);
    }

    function pick(e) {
      if (e === picked) return;
      picked = e;
      if (e >= 0) status.textContent = sentence(data, e);
      redraw();
    }

    function zoom(factor, x, y) {
      const bounded = Math.min(1e4, Math.max(0.1, view.zoom * factor)) / view.zoom;
      const cx = canvas.clientWidth / 2, cy = tall() / 2;
      view.x = x - cx - bounded * (x - cx - view.x);
      view.y = y - cy - bounded * (y - cy - view.y);
      view.zoom *= bounded;
      redraw();
    }

    const middle = () => [canvas.clientWidth / 2, tall() / 2];
    const turns = (event) => data.dimensions === 3 && !event.shiftKey && event.buttons !== 2;
    function drag(dx, dy, turning) {
      if (turning) {
        view.turn += 0.01 * dx;
        view.tilt = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, view.tilt + 0.01 * dy));
      } else {
        view.x += dx;
        view.y += dy;
      }
      redraw();
    }

    const pointers = new Map();
    const at = (event) => [event.offsetX, event.offsetY];
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, at(event));
      if (flat && pointers.size === 1) pick(nearest(data.edges, flat, ...at(event), 12, shown));
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = at(event), before = pointers.get(event.pointerId);
      if (!before) {
        if (flat) pick(nearest(data.edges, flat, ...now, 6, shown));
        return;
      }
      pointers.set(event.pointerId, now);
      if (pointers.size === 1) {
        drag(now[0] - before[0], now[1] - before[1], turns(event));
        return;
      }
      const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
      if (was > 0) zoom(Math.hypot(now[0] - other[0], now[1] - other[1]) / was, ...other);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return;
      event.preventDefault();
      zoom(Math.exp(-0.0015 * event.deltaY), ...at(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] }[event.key];
      if (step) drag(...step, data.dimensions === 3 && !event.shiftKey);
      else if (event.key === "+" || event.key === "=") zoom(1.2, ...middle());
      else if (event.key === "-") zoom(1 / 1.2, ...middle());
      else if (event.key === "0") reset();
      else return;
      event.preventDefault();
    });
    function reset() {
      view = start(data);
      redraw();
    }
    element.querySelector(".reset").addEventListener("click", reset);
    element.querySelector(".next").addEventListener("click", () => {
      place = (place + 1) % data.edges.length;
      pick(ranking(measure().values)[place]);
    });
    select.addEventListener("change", () => { place = -1; legend(); redraw(); });
    every.addEventListener("change", redraw);
    if (seen) seen.addEventListener("change", redraw);
    if (known) known.addEventListener("change", redraw);
    if (early) early.addEventListener("change", redraw);
    for (const { box } of sure) box.addEventListener("change", redraw);
    const repaint = () => { legend(); draw(); };
    document.addEventListener("themechange", repaint);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
    new ResizeObserver(redraw).observe(canvas);
    element.querySelector(".tools").hidden = false;
    legend();
    draw();
  }

  return { bucket, camera, colour, distance, fitted, frame, framed, nearest, outline, project, ranking, round, seenFrom, sentence, start, show };
})();
if (typeof document !== "undefined") document.querySelectorAll(".scene").forEach(Scene.show);
