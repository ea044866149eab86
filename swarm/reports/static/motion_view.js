// A motion to turn, to scrub and to play: the page has motion_scene.js and motion_camera.js
// before this file.

const REDUCED = matchMedia("(prefers-reduced-motion: reduce)");

function motionView(section) {
  const find = (name) => section.querySelector(name);
  const canvas = find(".space"), labels = find(".labels"), slider = find("input");
  const playButton = find(".play"), now = find(".now"), speed = find("select");
  const marks = [...section.querySelectorAll(".moments button")];
  const spans = [...section.querySelectorAll(".phases span")].map((element) =>
    ({ element, name: element.textContent, start: +element.dataset.start, end: +element.dataset.end }));
  let paint = painter(canvas);
  if (!paint) return;
  find(".fallback").hidden = true;
  find(".player").hidden = false;

  const data = JSON.parse(find("script").textContent);
  const frameAt = frames(data);
  const field = data.unit * 32767 + Math.hypot(data.centre[0], data.centre[1]);
  const spacing = field > 40 ? 5 : field > 15 ? 2 : 1; // metres; wide fields would look grey
  const lines = fieldLines(field, spacing, data.lines);
  const home = { yaw: -0.5, pitch: 0.62, zoom: 1 };
  let { yaw, pitch, zoom } = home;
  let time = data.shown, playing = false, touched = false;
  let pending = 0, last = 0; // the next frame, and the time of the one before
  let chosen = null; // the moment that is shown
  let near = 0; // 0: the camera frames the team; 1: the two strands of the moment
  const goal = () => (chosen ? 1 : 0);

  function draw() {
    const frame = frameAt(time);
    const seen = [...frame.vehicles, ...frame.strands.flat()].filter(Boolean);
    const low = [0, 1, 2].map((x) => Math.min(...seen.map((p) => p[x])));
    const high = [0, 1, 2].map((x) => Math.max(...seen.map((p) => p[x])));
    let target = seen.length ? mix(low, high, 0.5) : data.centre;
    let reach = seen.length ? 0.5 * norm(subtract(high, low)) + data.radius : 5;
    const highlighted = chosen && highlight(frame);
    if (highlighted && highlighted.nearest) {
      const [a, b] = highlighted.nearest.ends;
      target = mix(target, mix(a, b, 0.5), near);
      reach += near * (Math.min(reach, 1.2 + 1.5 * highlighted.nearest.distance) - reach);
    }
    const aspect = canvas.width / canvas.height;
    const distance = (0.85 * reach * Math.max(1, 1 / aspect)) / Math.tan(FIELD_OF_VIEW / 2) / zoom;
    const { back, matrix } = camera(target, yaw, pitch, distance, aspect);
    paint(matrix, unit(add(back, [0, 0, 0.6])), lines, scene(data, frame, highlighted, distance));
    write(frame, highlighted, matrix);
    slider.value = time;
    const span = spans.findLast((one) => time >= one.start) || spans[0];
    now.textContent = `${time.toFixed(1)} s${span && span.name ? `, ${span.name}` : ""}`;
    slider.setAttribute("aria-valuetext", now.textContent);
    spans.forEach((one) => one.element.classList.toggle("current", one === span));
    marks.forEach((one) => one.setAttribute("aria-pressed", one === chosen));
  }

  function highlight(frame) {
    const things = JSON.parse(chosen.dataset.between).map((name) => {
      const [kind, number] = name.split(" ");
      return { kind, index: number - 1 };
    });
    const shapes = things.map(({ kind, index }) => {
      if (kind === "segment") return frame.strands[index] && smooth(frame.strands[index]);
      return kind === "vehicle" && frame.vehicles[index] && [add(frame.vehicles[index], [0, 0, data.grip])];
    });
    return { things, nearest: shapes.every(Boolean) ? nearest(...shapes) : null };
  }

  // Numbers of the vehicles, and of the two things of the moment.
  function write(frame, highlighted, matrix) {
    const pen = labels.getContext("2d"), size = canvas.width / canvas.clientWidth;
    pen.clearRect(0, 0, labels.width, labels.height);
    pen.font = `${12 * size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.fillStyle = "#667085";
    pen.fillText(`floor grid ${spacing} m`, 48 * size, labels.height - 8 * size);
    pen.lineWidth = 3 * size;
    pen.strokeStyle = "rgb(244 246 249 / 85%)";
    const text = (words, p, colour) => {
      const at = onCanvas(matrix, p, canvas);
      if (!at) return;
      pen.fillStyle = colour;
      pen.strokeText(words, at[0], at[1] - 8 * size);
      pen.fillText(words, at[0], at[1] - 8 * size);
    };
    const alarm = `rgb(${ALARM.map((part) => 255 * part)})`;
    frame.vehicles.forEach((p, k) => p && text(`${k + 1}`, add(p, [0, 0, data.grip]), "#303848"));
    for (const { kind, index } of highlighted ? highlighted.things : []) {
      const strand = kind === "segment" && frame.strands[index];
      if (strand) text(`segment ${index + 1}`, strand[strand.length >> 1], alarm);
    }
  }

  function tick(stamp) {
    pending = 0;
    const passed = last ? Math.min((stamp - last) / 1000, 0.2) : 0;
    last = stamp;
    if (playing) time = Math.min(time + passed * speed.value, data.end);
    if (time >= data.end) play(false);
    near = clamp(near + Math.sign(goal() - near) * passed * 2.5, 0, 1);
    draw();
    if (playing || near !== goal()) run();
    else last = 0;
  }

  function run() {
    pending ||= requestAnimationFrame(tick);
  }

  function play(on) {
    if (on && (!touched || time >= data.end)) time = data.begin;
    touched ||= on;
    playing = on;
    playButton.textContent = on ? "Pause" : "Play";
    if (on) run();
  }

  function jump(to) {
    touched = true;
    time = clamp(to, data.start, data.end);
    draw();
  }

  function choose(mark) {
    play(false);
    chosen = mark;
    if (!mark || REDUCED.matches) near = goal();
    if (near !== goal()) run();
    if (mark) jump(+mark.dataset.time);
    else draw();
  }

  function turn(right, down) {
    yaw -= right;
    pitch = clamp(pitch + down, -0.2, 1.55);
    draw();
  }

  function magnify(factor) {
    zoom = clamp(zoom * factor, 0.4, 12);
    draw();
  }

  function whole() {
    ({ yaw, pitch, zoom } = home);
    choose(null);
  }

  slider.addEventListener("input", () => jump(+slider.value));
  playButton.addEventListener("click", () => play(!playing));
  find(".whole").addEventListener("click", whole);
  marks.forEach((mark) => mark.addEventListener("click", () => choose(mark === chosen ? null : mark)));
  spans.forEach((span) => span.element.addEventListener("click", () => jump(span.start)));

  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
    ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => magnify(1.15), "=": () => magnify(1.15), "-": () => magnify(1 / 1.15),
    " ": () => play(!playing), Home: whole,
  };
  canvas.addEventListener("keydown", (event) => {
    const act = !event.ctrlKey && !event.metaKey && !event.altKey && keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  gestures(canvas, turn, magnify);

  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    paint = painter(canvas);
    draw();
  });
  new ResizeObserver(() => {
    const ratio = Math.min(devicePixelRatio, 2);
    for (const one of [canvas, labels]) {
      one.width = Math.max(1, canvas.clientWidth * ratio);
      one.height = Math.max(1, canvas.clientHeight * ratio);
    }
    draw();
  }).observe(canvas);
}

document.querySelectorAll(".motion").forEach(motionView);
