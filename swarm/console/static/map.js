// The pictures of the team: from above, from the side, and in space. Lengths are in metres, z is
// up. Shapes and camera of the view in space are those of the reports (motion_scene.js,
// motion_camera.js), which the page has before this file.

const LEAST_RADIUS = 8; // pixels of a vehicle: its number can be read

const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const darkScheme = matchMedia("(prefers-color-scheme: dark)");

function palette() {
  const names = ["ink", "dim", "line", "card", "path", "fence", "good", "warn", "bad", "idle"];
  return Object.fromEntries(names.map((name) => [name, variable(`--${name}`)]));
}

// Fits the canvas to its place; returns its context, scaled to CSS pixels.
function prepared(canvas) {
  const ratio = Math.min(devicePixelRatio, 2);
  const width = Math.max(1, canvas.clientWidth), height = Math.max(1, canvas.clientHeight);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  pen.lineJoin = "round";
  return { pen, width, height };
}

// A colour along the cable, from its first segment to its last.
function alongCable(k, count, dark) {
  const share = count > 1 ? k / (count - 1) : 0;
  return `hsl(${210 + 130 * share} 65% ${dark ? 66 : 45}%)`;
}

function line(pen, points, colour, width, dash = []) {
  pen.beginPath();
  points.forEach((p, k) => (k ? pen.lineTo(...p) : pen.moveTo(...p)));
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

function words(pen, text, x, y, colour, halo, align = "center") {
  pen.textAlign = align;
  pen.textBaseline = "middle";
  pen.lineWidth = 3;
  pen.strokeStyle = halo;
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

const known = (p) => p && p[0] !== null && p[1] !== null && p[2] !== null;

// The cable, piece by piece, the highest last: what is above hides what is below.
function cable(pen, strands, at, height, colours, dark) {
  const pieces = [];
  strands.forEach((points, k) => {
    const colour = alongCable(k, strands.length, dark);
    for (let i = 0; i + 1 < points.length; i++) {
      const [a, b] = [points[i], points[i + 1]];
      if (known(a) && known(b)) pieces.push({ a, b, colour, order: height(a) + height(b) });
    }
  });
  pieces.sort((one, other) => one.order - other.order);
  for (const { a, b, colour } of pieces) {
    pen.lineCap = "butt";
    line(pen, [at(a), at(b)], colours.card, 7);
    pen.lineCap = "round";
    line(pen, [at(a), at(b)], colour, 2.5);
  }
  pen.lineCap = "butt";
}

function vehicle(pen, x, y, radius, row, colours) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.globalAlpha = 0.85;
  pen.fillStyle = colours.card;
  pen.fill();
  pen.globalAlpha = 1;
  pen.lineWidth = row.level === "bad" ? 3.5 : 2;
  pen.strokeStyle = colours[row.level];
  pen.stroke();
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillStyle = row.level === "bad" ? colours.bad : colours.ink;
  pen.font = "600 12px system-ui, sans-serif";
  pen.fillText(row.number, x, y + 0.5);
  pen.font = "12px system-ui, sans-serif";
}

const niceStep = (metres) => [0.5, 1, 2, 5, 10, 20, 50].find((step) => step >= metres) || 100;

// What bounds the workspace.
function bounds(pen, plan, at, colours) {
  Object.values(plan.lines).flat().forEach((strip) =>
    line(pen, strip.map(at), colours.fence, 1.5, [7, 4]));
}

function drawAbove(canvas, plan, state) {
  const { pen, width, height } = prepared(canvas), colours = palette(), dark = darkScheme.matches;
  const shown = [plan.low, plan.high, ...plan.pads];
  const span = Math.max(plan.high[0] - plan.low[0], plan.high[1] - plan.low[1], 4);
  shown.push(...Object.values(plan.lines).flat(2).filter((p) =>
    p[0] > plan.low[0] - span && p[0] < plan.high[0] + span
    && p[1] > plan.low[1] - span && p[1] < plan.high[1] + span));
  if (state) shown.push(...state.rows.map((row) => row.place).filter(known));
  const low = [0, 1].map((x) => Math.min(...shown.map((p) => p[x])));
  const high = [0, 1].map((x) => Math.max(...shown.map((p) => p[x])));
  const edge = 26, scale = Math.min(
    (width - 2 * edge) / Math.max(high[0] - low[0], 1),
    (height - 2 * edge) / Math.max(high[1] - low[1], 1));
  const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const at = (p) => [
    width / 2 + scale * (p[0] - middle[0]), height / 2 - scale * (p[1] - middle[1])];
  const step = niceStep(70 / scale);
  for (let x = Math.ceil((middle[0] - width / scale) / step) * step; x < middle[0] + width / scale; x += step)
    line(pen, [[at([x, 0])[0], 0], [at([x, 0])[0], height]], colours.line, 0.5);
  for (let y = Math.ceil((middle[1] - height / scale) / step) * step; y < middle[1] + height / scale; y += step)
    line(pen, [[0, at([0, y])[1]], [width, at([0, y])[1]]], colours.line, 0.5);
  bounds(pen, plan, at, colours);
  plan.paths.forEach((path) => line(pen, path.map(at), colours.path, 1));
  plan.pads.forEach((pad) => {
    const [x, y] = at(pad);
    pen.strokeStyle = colours.dim;
    pen.lineWidth = 1;
    pen.strokeRect(x - 5, y - 5, 10, 10);
  });
  if (state) {
    cable(pen, state.strands, at, (p) => p[2], colours, dark);
    for (const row of state.rows) {
      if (!known(row.place)) continue;
      const [x, y] = at(row.place);
      if (known(row.target)) line(pen, [at(row.target), [x, y]], colours.warn, 2);
      vehicle(pen, x, y, Math.max(scale * plan.radius, LEAST_RADIUS), row, colours);
    }
  }
  const bar = step * scale;
  line(pen, [[10, height - 10], [10 + bar, height - 10]], colours.ink, 2);
  words(pen, `${step} m`, 14 + bar, height - 10, colours.ink, colours.card, "left");
  const dashed = Object.keys(plan.lines).join(", ");
  const note = dashed ? `from above; dashed: ${dashed}` : "from above; no fence";
  words(pen, note, 10, 12, colours.dim, colours.card, "left");
  if (plan.north === null) return;
  const [dx, dy] = [Math.cos(plan.north), -Math.sin(plan.north)], [x, y] = [width - 22, 26];
  line(pen, [[x - 13 * dx, y - 13 * dy], [x + 13 * dx, y + 13 * dy]], colours.ink, 2);
  line(pen, [-0.5, 0.5].map((turn) => {
    const angle = Math.atan2(dy, dx) + Math.PI + turn;
    return [x + 13 * dx + 8 * Math.cos(angle), y + 13 * dy + 8 * Math.sin(angle)];
  }).toSpliced(1, 0, [x + 13 * dx, y + 13 * dy]), colours.ink, 2);
  words(pen, "N", x - 20 * dx, y - 20 * dy, colours.ink, colours.card);
}

function drawSide(canvas, plan, state) {
  const { pen, width, height } = prepared(canvas), colours = palette(), dark = darkScheme.matches;
  const places = state ? state.rows.map((row) => row.place).filter(known) : [];
  const low = Math.min(plan.low[0], ...places.map((p) => p[0]));
  const high = Math.max(plan.high[0], ...places.map((p) => p[0]));
  const top = Math.max(plan.high[2], 1, ...places.map((p) => p[2])) + plan.grip + 0.5;
  const left = 40, scale = Math.min((width - left - 22) / Math.max(high - low, 1), (height - 34) / top);
  const middle = (low + high) / 2, floor = height - 16;
  const at = (p) => [
    (width + left - 22) / 2 + scale * (p[0] - middle), floor - scale * p[2]];
  const step = niceStep(34 / scale);
  bounds(pen, plan, at, colours);
  for (let z = 0; z * scale < floor - 8; z += step) {
    line(pen, [[left, floor - scale * z], [width - 6, floor - scale * z]], colours.line, z ? 0.5 : 1.5);
    words(pen, `${z} m`, left - 4, floor - scale * z, colours.dim, colours.card, "right");
  }
  const ceiling = floor - scale * plan.ceiling;
  if (ceiling > 14) line(pen, [[left, ceiling], [width - 6, ceiling]], colours.fence, 1.5, [7, 4]);
  if (state) {
    cable(pen, state.strands, at, (p) => -p[1], colours, dark);
    for (const row of state.rows) {
      if (!known(row.place)) continue;
      const grip = at(row.place), hub = at([row.place[0], 0, row.place[2] + plan.grip]);
      line(pen, [grip, hub], colours.dim, 1.5);
      vehicle(pen, hub[0], hub[1], LEAST_RADIUS, row, colours);
    }
  }
  words(pen, "from the side, along y", left, height - 6, colours.dim, colours.card, "left");
}

// The view in space of the reports, fed live.
function spaceView(canvas, labels) {
  const paint = painter(canvas);
  let yaw = -0.5, pitch = 0.62, zoom = 1, last = null;

  function coloured() {
    const dark = darkScheme.matches;
    [INK, ROTOR, FAINT, PAPER] = dark
      ? [[0.85, 0.87, 0.91], [0.55, 0.6, 0.68], [0.25, 0.28, 0.34], [0.09, 0.106, 0.133]]
      : [[0.19, 0.22, 0.28], [0.45, 0.5, 0.58], [0.78, 0.8, 0.84], [1, 1, 1]];
    return dark;
  }

  function draw(plan, state) {
    if (!paint || !plan || !state) return;
    last = [plan, state];
    const dark = coloured(), ratio = Math.min(devicePixelRatio, 2);
    for (const one of [canvas, labels]) {
      one.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      one.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    }
    const count = Math.max(state.strands.length, 1);
    const data = { radius: plan.radius, grip: plan.grip, cable: plan.cable,
      colours: Array.from({ length: count }, (_, k) => mix([0.2, 0.5, 0.8], [0.8, 0.35, 0.6], k / count)) };
    const vehicles = state.rows.map((row) => (known(row.place) ? row.place : null));
    const strands = state.strands.map((points) => (points.every(known) ? points : null));
    const seen = [...vehicles, ...strands.flat()].filter(Boolean);
    if (!seen.length) return;
    const low = [0, 1, 2].map((x) => Math.min(...seen.map((p) => p[x])));
    const high = [0, 1, 2].map((x) => Math.max(...seen.map((p) => p[x])));
    const target = mix(low, high, 0.5), reach = 0.5 * norm(subtract(high, low)) + data.radius;
    const aspect = canvas.width / canvas.height;
    const distance = (1.05 * reach * Math.max(1, 1 / aspect)) / Math.tan(FIELD_OF_VIEW / 2) / zoom;
    const { back, matrix } = camera(target, yaw, pitch, distance, aspect);
    const field = Math.max(...plan.high.map(Math.abs), ...plan.low.map(Math.abs)) + 2;
    paint(matrix, unit(add(back, [0, 0, 0.6])), fieldLines(field, field > 15 ? 2 : 1,
      Object.values(plan.lines).flat()), scene(data, { vehicles, strands }, null, distance));
    const pen = labels.getContext("2d");
    pen.font = `600 ${13 * ratio}px system-ui, sans-serif`;
    pen.textAlign = "center";
    state.rows.forEach((row, k) => {
      const p = vehicles[k] && onCanvas(matrix, add(vehicles[k], [0, 0, data.grip]), canvas);
      if (!p) return;
      pen.lineWidth = 3 * ratio;
      pen.strokeStyle = dark ? "#171b22" : "#fff";
      pen.strokeText(row.number, p[0], p[1] - 8 * ratio);
      pen.fillStyle = row.level === "bad" ? variable("--bad") : variable("--ink");
      pen.fillText(row.number, p[0], p[1] - 8 * ratio);
    });
  }

  const again = () => last && draw(...last);
  const turn = (right, down) => { yaw -= right; pitch = clamp(pitch + down, -0.2, 1.55); again(); };
  const magnify = (factor) => { zoom = clamp(zoom * factor, 0.4, 12); again(); };
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1),
    ArrowDown: () => turn(0, -0.1), "+": () => magnify(1.15), "-": () => magnify(1 / 1.15),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    event.stopPropagation();
    keys[event.key]();
  });
  gestures(canvas, turn, magnify);
  return draw;
}
