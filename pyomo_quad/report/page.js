// What moves on the page: tables sort, figures grow, and the flight plays in space and in charts.
"use strict";
(() => {
  const number = (text) => parseFloat(text.replace("−", "-"));

  for (const table of document.querySelectorAll("table")) {
    const body = table.tBodies[0];
    if (!body || !table.tHead) continue;
    // A phone shows each row as a card, with the heading beside each cell.
    const heads = [...table.tHead.rows[0].cells].map((head) => head.textContent.trim());
    for (const row of body.rows) {
      for (const cell of row.cells) cell.dataset.label = heads[cell.cellIndex] ?? "";
    }
    // The first table of the page has few columns and stays a table.
    if (!table.closest(".top")) table.classList.add("cards");
    for (const head of table.tHead.querySelectorAll("th")) {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      if (!button.textContent.trim()) continue;
      head.append(button);
      button.addEventListener("click", () => {
        const way = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
        for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", way > 0 ? "ascending" : "descending");
        const cell = (row) => row.cells[head.cellIndex]?.textContent.trim() ?? "";
        const rows = [...body.rows].sort((a, b) => {
          const [x, y] = [number(cell(a)), number(cell(b))];
          // What is no number stands last either way.
          if (isNaN(x) !== isNaN(y)) return isNaN(x) ? 1 : -1;
          return way * (isNaN(x) ? cell(a).localeCompare(cell(b)) : x - y);
        });
        body.append(...rows);
      });
    }
  }

  for (const image of document.querySelectorAll("figure img")) {
    const grow = () => image.classList.toggle("large");
    image.tabIndex = 0;
    image.setAttribute("role", "button");
    image.addEventListener("click", grow);
    image.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      grow();
    });
  }

  // Sections are folded: a link opens its own, and paper has them all.
  const sections = [...document.querySelectorAll("details.part")];
  const unfold = () => {
    const wanted = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (wanted?.matches("details")) {
      wanted.open = true;
      wanted.scrollIntoView();
    }
  };
  addEventListener("hashchange", unfold);
  for (const link of document.querySelectorAll("nav a")) link.addEventListener("click", () => setTimeout(unfold));
  unfold();
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = sections.filter((section) => !section.open);
    for (const section of folded) section.open = true;
  });
  addEventListener("afterprint", () => {
    for (const section of folded) section.open = false;
  });
  // On a phone the contents would fill the first screen.
  const phone = matchMedia("(max-width: 42rem)");
  const fold = () => {
    for (const contents of document.querySelectorAll("nav details")) contents.open = !phone.matches;
  };
  phone.addEventListener("change", fold);
  fold();

  const source = document.getElementById("flight-data");
  const view = document.getElementById("flight-view");
  if (!source || !view) return;
  const scene = JSON.parse(source.textContent);
  const flights = scene.flights;
  const end = Math.max(...flights.map((flight) => flight.t[flight.t.length - 1]));
  view.data = flights;

  // -- the time that everything shows, and the values at it ------------------------------------
  let now = 0;
  const at = (flight, values, t) => {
    const times = flight.t;
    let high = times.length - 1, low = 0;
    if (t >= times[high]) return values[high];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] > t) high = middle; else low = middle;
    }
    const share = Math.min(Math.max((t - times[low]) / (times[high] - times[low]), 0), 1);
    return values[low] + share * (values[high] - values[low]);
  };
  const place = (flight, t) => ["x", "y", "z"].map((axis) => at(flight, flight[axis], t));

  // -- the view in space ------------------------------------------------------------------------
  const canvas = document.createElement("canvas");
  view.append(canvas);
  const pen = canvas.getContext("2d");
  const camera = { azimuth: -1.0, elevation: 0.42, zoom: 1 };
  view.camera = camera;
  const shown = () => flights.filter((flight) => flight.visible);
  const reach = (axis) => {
    const values = flights.filter((f) => f.framed).flatMap((f) => f[axis]);
    let [low, high] = [Math.min(...values), Math.max(...values)];
    // Zones may be far taller than the flight: their heights are cut, not shown small.
    for (const zone of axis === "z" ? [] : scene.zones) {
      low = Math.min(low, zone.low[axis]);
      high = Math.max(high, zone.high[axis]);
    }
    return [low, high];
  };
  const cut = ({ low, high, ...zone }) => {
    const [least, most] = [box[2][0], box[2][1] + 0.15 * size];
    const clip = (z) => Math.min(Math.max(z, least), most);
    return zone.shape === "sphere" ? { low, high, ...zone } : {
      ...zone, low: { ...low, z: clip(low.z) }, high: { ...high, z: clip(high.z) },
    };
  };
  let box, middle, size;
  const measure = () => {
    box = ["x", "y", "z"].map(reach);
    middle = box.map(([low, high]) => (low + high) / 2);
    size = Math.max(Math.hypot(...box.map(([low, high]) => high - low)), 0.5);
  };
  measure();

  const project = ([x, y, z]) => {
    const [dx, dy, dz] = [x - middle[0], y - middle[1], z - middle[2]];
    const [c, s] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth)];
    const [ce, se] = [Math.cos(camera.elevation), Math.sin(camera.elevation)];
    const across = c * dx + s * dy, away = -s * dx + c * dy;
    const depth = away * ce - dz * se, up = away * se + dz * ce;
    const distance = 2.4 * size;
    const scale = (camera.zoom * 0.9 * Math.min(canvas.clientWidth, canvas.clientHeight) / size)
      * distance / (distance + depth);
    return [canvas.clientWidth / 2 + across * scale, canvas.clientHeight / 2 - up * scale];
  };
  const line = (points, color, width = 1, dash = []) => {
    pen.beginPath();
    points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](...project(point)));
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  };
  // Labels are written last, the important ones first: each where it meets no other, and left out
  // where there is no such place.
  const [NAME, AXIS, TICK] = [0, 1, 2];
  const HIGH = 14, GAP = 6;
  let labels = [];
  const label = (text, point, color, rank, way = 1) => {
    labels.push({ text: `${text}`, point: project(point), color, rank, way });
  };
  const write = () => {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const placed = [];
    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 3;
    pen.strokeStyle = "#fff";
    pen.lineJoin = "round";
    for (const { text, point: [x, y], color, rank, way } of labels.sort((a, b) => a.rank - b.rank)) {
      const wide = pen.measureText(text).width;
      const isSeen = x >= 0 && x <= width && y >= 0 && y <= height;
      if (!isSeen && rank !== AXIS) continue;
      const beside = way > 0 ? [x + GAP, x - GAP - wide] : [x - GAP - wide, x + GAP];
      const places = [beside[0], x - wide / 2, beside[1]]
        .flatMap((left) => [y - HIGH, y + GAP / 2, y - 2 * HIGH].map((top) => [left, top]))
        .map(([left, top]) => [
          Math.min(Math.max(left, 2), width - wide - 2), Math.min(Math.max(top, 2), height - HIGH - 2),
        ]);
      const place = places.find(([left, top]) => placed.every((other) => (
        left > other.right || left + wide < other.left
        || top > other.bottom || top + HIGH < other.top)));
      if (!place) continue;
      const [left, top] = place;
      placed.push({ text, left, top, right: left + wide, bottom: top + HIGH });
      pen.fillStyle = color;
      pen.strokeText(text, left, top + HIGH - 3);
      pen.fillText(text, left, top + HIGH - 3);
    }
    labels = [];
    view.labels = placed;
  };
  const step = (span) => {
    const rough = span / 4, power = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  };
  const circle = (centre, radius, one, other) => Array.from({ length: 33 }, (_, k) => {
    const angle = (k * Math.PI) / 16;
    return centre.map((c, i) => c + radius * (one[i] * Math.cos(angle) + other[i] * Math.sin(angle)));
  });
  const grid = () => {
    const [bx, by, bz] = box, floor = bz[0], pace = step(size);
    const range = ([low, high]) => [Math.floor(low / pace) * pace, Math.ceil(high / pace) * pace];
    const [[x0, x1], [y0, y1], [, z1]] = [bx, by, bz].map(range);
    for (let x = x0; x <= x1 + pace / 9; x += pace) {
      line([[x, y0, floor], [x, y1, floor]], "#dcdcdc");
      label(+x.toFixed(6), [x, y0, floor], "#666", TICK);
    }
    for (let y = y0; y <= y1 + pace / 9; y += pace) {
      line([[x0, y, floor], [x1, y, floor]], "#dcdcdc");
      if (y > y0) label(+y.toFixed(6), [x0, y, floor], "#666", TICK);
    }
    line([[x0, y0, floor], [x0, y0, z1]], "#bbb");
    for (let z = Math.ceil(floor / pace) * pace; z <= z1 + pace / 9; z += pace) {
      if (z > floor) label(+z.toFixed(6), [x0, y0, z], "#666", TICK, -1);
    }
    label("x (m)", [(x0 + x1) / 2, y0 - pace / 2, floor], "#222", AXIS);
    label("y (m)", [x0 - pace / 2, (y0 + y1) / 2, floor], "#222", AXIS);
    label("z (m)", [x0, y0, z1 + pace / 4], "#222", AXIS, -1);
  };
  const zones = () => {
    for (const zone of scene.zones.map(cut)) {
      const [a, b] = [zone.low, zone.high], color = "#a33a2a";
      if (zone.shape === "box" || zone.shape === "polygon") {
        const ring = zone.corners ? zone.corners.map(({ x, y }) => [x, y])
          : [[a.x, a.y], [b.x, a.y], [b.x, b.y], [a.x, b.y]];
        for (const z of [a.z, b.z]) {
          line([...ring, ring[0]].map(([x, y]) => [x, y, z]), color);
        }
        for (const [x, y] of ring) line([[x, y, a.z], [x, y, b.z]], color);
      } else {
        const radius = (b.x - a.x) / 2, c = [(a.x + b.x) / 2, (a.y + b.y) / 2, (a.z + b.z) / 2];
        const [ex, ey, ez] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        if (zone.shape === "sphere") {
          for (const pair of [[ex, ey], [ex, ez], [ey, ez]]) line(circle(c, radius, ...pair), color);
        } else {
          for (const z of [a.z, c[2], b.z]) line(circle([c[0], c[1], z], radius, ex, ey), color);
          for (const [dx, dy] of [[1, 0], [0, 1], [-1, 0], [0, -1]]) {
            const side = [c[0] + radius * dx, c[1] + radius * dy];
            line([[...side, a.z], [...side, b.z]], color);
          }
        }
      }
      label(zone.name, [(a.x + b.x) / 2, (a.y + b.y) / 2, b.z], color, NAME);
    }
  };
  // A vehicle that would be a dot is enlarged, and the page says by how much.
  const LEAST_SHARE = 0.05;
  let arm = scene.arm;
  const scaled = () => {
    arm = Math.max(scene.arm, LEAST_SHARE * size);
    const times = arm / scene.arm;
    document.getElementById("flight-scale").textContent = times > 1.01
      ? `The vehicle is drawn ${times < 10 ? times.toFixed(1) : times.toFixed(0)} times its size.`
      : "The vehicle is drawn to scale.";
  };
  scaled();
  const body = (flight, t) => {
    // Columns: the body's axes in the world, yaw, pitch and roll in that order.
    const [phi, theta, psi] = ["phi", "theta", "psi"].map((a) => at(flight, flight[a], t));
    const [cf, sf, ct, st, cp, sp] = [phi, theta, psi].flatMap((a) => [Math.cos(a), Math.sin(a)]);
    return [
      [ct * cp, ct * sp, -st],
      [sf * st * cp - cf * sp, sf * st * sp + cf * cp, sf * ct],
      [cf * st * cp + sf * sp, cf * st * sp - sf * cp, cf * ct],
    ];
  };
  const arrow = (from, by, color, width) => {
    const tip = from.map((c, i) => c + by[i]);
    line([from, tip], color, width);
    const [a, b] = [project(from), project(tip)];
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
    if (Math.hypot(b[0] - a[0], b[1] - a[1]) < 3) return;
    pen.beginPath();
    for (const side of [2.6, -2.6]) {
      pen.moveTo(...b);
      pen.lineTo(b[0] + 9 * Math.cos(angle + side), b[1] + 9 * Math.sin(angle + side));
    }
    pen.stroke();
  };
  const vehicle = (flight, t) => {
    const centre = place(flight, t);
    if (flight.phi) {
      const [ahead, left, up] = body(flight, t);
      for (const [axis, way] of [[ahead, 1], [left, 1], [ahead, -1], [left, -1]]) {
        const tip = centre.map((c, i) => c + way * arm * axis[i]);
        const isFront = axis === ahead && way > 0;
        line([centre, tip], isFront ? "#111" : flight.color, isFront ? 3 : 2);
        line(circle(tip, 0.4 * arm, ahead, left), flight.color, 1.5);
      }
      arrow(centre, up.map((u) => 1.3 * arm * u), "#111", 1);
    }
    const [x, y] = project(centre);
    pen.beginPath();
    pen.arc(x, y, 3.5, 0, 7);
    pen.fillStyle = flight.color;
    pen.fill();
    if (flight.wind) {
      const wind = flight.wind.map((values) => at(flight, values, t));
      const speed = Math.hypot(...wind);
      if (speed > 1e-3) {
        const from = centre.map((c, i) => c + (i === 2 ? 2 * arm : 0));
        arrow(from, [...wind.map((w) => (0.16 * size * w) / scene.fastest_wind), 0], "#3a6ea5", 2);
        if (flight === shown()[0]) label(`wind ${speed.toFixed(1)} m/s`, from, "#3a6ea5", NAME);
      }
    }
  };
  const draw = () => {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [view.clientWidth, view.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    grid();
    zones();
    const floor = box[2][0];
    for (const flight of shown()) {
      const points = flight.t.map((_, i) => [flight.x[i], flight.y[i], flight.z[i]]);
      line(points.map(([x, y]) => [x, y, floor]), "#d8d8d8", 1);
      line(points, flight.color, 2, flight.dashes);
    }
    for (const [text, point] of scene.ends) {
      const [x, y] = project(point);
      pen.fillStyle = "#222";
      pen.fillRect(x - 3, y - 3, 6, 6);
      label(text, point, "#222", NAME);
    }
    for (const flight of shown()) vehicle(flight, now);
    write();
  };

  // Drag turns; a finger that goes up or down scrolls the page.
  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    held = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    camera.azimuth += (event.clientX - held[0]) / 150;
    if (event.pointerType !== "touch") camera.elevation += (event.clientY - held[1]) / 150;
    camera.elevation = Math.min(Math.max(camera.elevation, -0.2), 1.5);
    held = [event.clientX, event.clientY];
    draw();
  });
  const KEYS = {
    ArrowLeft: () => { camera.azimuth -= 0.1; },
    ArrowRight: () => { camera.azimuth += 0.1; },
    ArrowUp: () => { camera.elevation = Math.min(camera.elevation + 0.1, 1.5); },
    ArrowDown: () => { camera.elevation = Math.max(camera.elevation - 0.1, -0.2); },
    "+": () => { camera.zoom *= 1.25; },
    "-": () => { camera.zoom *= 0.8; },
    " ": () => (playing ? stop() : play()),
  };
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "The flights in space: arrow keys turn, plus and minus zoom, space plays.");
  canvas.addEventListener("keydown", (event) => {
    const act = KEYS[event.key];
    if (!act) return;
    event.preventDefault();
    act();
    draw();
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(kind, () => { held = null; });
  }

  // -- the charts -------------------------------------------------------------------------------
  const charts = [];
  const holder = document.getElementById("flight-charts");
  for (const [group, signals] of scene.groups) {
    const section = document.createElement("div");
    section.className = "charts";
    const title = document.createElement("h3");
    title.textContent = group;
    holder.append(title, section);
    for (const signal of signals) {
      const chart = document.createElement("div");
      chart.className = "chart";
      chart.innerHTML = '<p class="title"></p><div class="plot"><canvas></canvas><i></i></div><p class="values"></p>';
      chart.querySelector(".title").textContent = `${signal.name} (${signal.unit})`;
      section.append(chart);
      charts.push({
        signal, element: chart, canvas: chart.querySelector("canvas"),
        cursor: chart.querySelector("i"), values: chart.querySelector(".values"),
      });
      const follow = (event) => {
        const frame = chart.querySelector(".plot").getBoundingClientRect();
        stop();
        show(((event.clientX - frame.left) / frame.width) * end);
      };
      chart.querySelector(".plot").addEventListener("pointermove", follow);
      chart.querySelector(".plot").addEventListener("pointerdown", follow);
    }
  }
  const digits = (value) => (Math.abs(value) >= 100 ? value.toFixed(1) : value.toPrecision(3));
  const drawChart = ({ signal, canvas: sheet }) => {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [sheet.clientWidth, sheet.clientHeight];
    if (!width) return;
    sheet.width = width * ratio;
    sheet.height = height * ratio;
    const ink = sheet.getContext("2d");
    ink.setTransform(ratio, 0, 0, ratio, 0, 0);
    const drawn = shown().filter((flight) => flight.series[signal.key]);
    const all = drawn.flatMap((flight) => flight.series[signal.key]).filter((v) => v !== null);
    if (!all.length) return;
    let low = all.reduce((a, b) => Math.min(a, b)), high = all.reduce((a, b) => Math.max(a, b));
    const missing = Math.max(signal.span - (high - low), 0) / 2;
    [low, high] = [low - missing, high + missing];
    ink.fillStyle = "#666";
    ink.font = "10px system-ui, sans-serif";
    ink.fillText(digits(high), 2, 10);
    ink.fillText(digits(low), 2, height - 3);
    const y = (value) => height - 6 - ((value - low) / (high - low)) * (height - 12);
    for (const flight of [...drawn].reverse()) {
      ink.beginPath();
      flight.series[signal.key].forEach((value, i) => {
        if (value !== null) ink.lineTo((flight.t[i] / end) * width, y(value));
      });
      ink.strokeStyle = flight.color;
      ink.lineWidth = 1.4;
      ink.setLineDash(flight.dashes.map((d) => d / 2));
      ink.stroke();
    }
  };
  const readings = () => {
    for (const { signal, cursor, values } of charts) {
      cursor.style.left = `${(100 * now) / end}%`;
      values.replaceChildren(...shown().filter((f) => f.series[signal.key]).map((flight) => {
        const value = document.createElement("span");
        value.style.color = flight.color;
        value.textContent = digits(at(flight, flight.series[signal.key], now));
        value.title = flight.name;
        return value;
      }));
    }
  };

  // -- the controls -----------------------------------------------------------------------------
  const slider = document.getElementById("flight-time");
  const clock = document.getElementById("flight-clock");
  const button = document.getElementById("flight-play");
  slider.max = end;
  let playing = null;
  const show = (t) => {
    now = Math.min(Math.max(t, 0), end);
    slider.value = now;
    clock.textContent = `${now.toFixed(2)} s of ${end.toFixed(2)} s`;
    draw();
    readings();
  };
  const stop = () => {
    playing = null;
    button.textContent = "Play";
  };
  const play = () => {
    button.textContent = "Pause";
    playing = { since: performance.now(), from: now < end ? now : 0 };
    const frame = (moment) => {
      if (!playing) return;
      show(playing.from + Math.max(moment - playing.since, 0) / 1000);
      if (now >= end) stop(); else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  };
  button.addEventListener("click", () => (playing ? stop() : play()));
  slider.addEventListener("input", () => { stop(); show(+slider.value); });
  for (const [name, factor] of [["flight-nearer", 1.25], ["flight-further", 0.8]]) {
    document.getElementById(name).addEventListener("click", () => {
      camera.zoom *= factor;
      draw();
    });
  }
  const names = document.getElementById("flight-names");
  for (const flight of flights) {
    const choice = document.createElement("label");
    const tick = document.createElement("input");
    tick.type = "checkbox";
    tick.checked = flight.visible;
    const mark = document.createElement("b");
    mark.style.background = flight.color;
    choice.append(tick, mark, ` ${flight.name}`);
    tick.addEventListener("change", () => {
      flight.visible = tick.checked;
      charts.forEach(drawChart);
      show(now);
    });
    names.append(choice);
  }
  const redraw = () => { charts.forEach(drawChart); show(now); };
  new ResizeObserver(redraw).observe(view);
  document.getElementById("flight-series").addEventListener("toggle", redraw);
  redraw();
})();
