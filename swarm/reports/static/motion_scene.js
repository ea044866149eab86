// The shapes that the view of a motion draws. The page holds the frames as JSON
// (swarm/reports/motion_view.py). Lengths are in metres, z is up.
"use strict";

const ALARM = [0.75, 0.19, 0.19];
const EDGE = [0.78, 0.35, 0.24];
// Colours of a light page; the console replaces them in a dark scheme.
let INK = [0.19, 0.22, 0.28];
let ROTOR = [0.45, 0.5, 0.58];
let FAINT = [0.78, 0.8, 0.84];
let PAPER = [0.957, 0.965, 0.976];
const THINNEST = 0.0024; // radius of drawn cable over camera distance: two pixels on a telephone
const SIDES = 6; // of the tube that is a strand
const BETWEEN = 4; // drawn pieces between two samples of a strand

const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const subtract = (a, b) => add(a, b, -1);
const mix = (a, b, s) => add([a[0] * (1 - s), a[1] * (1 - s), a[2] * (1 - s)], b, s);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => { const n = norm(a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const floored = (p) => [p[0], p[1], 0.004];


function decoded(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Int16Array(bytes.buffer);
}

// Returns a function of time: places of the vehicles, and the points of every strand; null where
// they are not known.
function frames(data) {
  const places = decoded(data.places);
  const strands = decoded(data.strands);
  const step = (data.end - data.start) / (data.frames - 1);
  return (time) => {
    const at = clamp((time - data.start) / step, 0, data.frames - 1);
    const first = Math.min(Math.floor(at), data.frames - 2);
    const point = (values, count, k) => {
      const i = 3 * (first * count + k), j = i + 3 * count;
      if (values[i + 2] === data.unknown || values[j + 2] === data.unknown) return null;
      const part = at - first;
      return [0, 1, 2].map((axis) =>
        data.centre[axis] + data.unit * ((1 - part) * values[i + axis] + part * values[j + axis]));
    };
    const series = (count, of) => Array.from({ length: count }, (_, k) => of(k));
    const perFrame = data.segments * data.points;
    return {
      vehicles: series(data.vehicles, (k) => point(places, data.vehicles, k)),
      strands: series(data.segments, (s) => {
        const found = series(data.points, (k) => point(strands, perFrame, s * data.points + k));
        return found.includes(null) ? null : found;
      }),
    };
  };
}

// A smooth curve (Catmull and Rom) through the samples of a strand.
function smooth(points) {
  const curve = [];
  for (let k = 0; k + 1 < points.length; k++) {
    const b = points[k], c = points[k + 1];
    const a = points[k - 1] || subtract(add(b, b), c), d = points[k + 2] || subtract(add(c, c), b);
    for (let i = 0; i < BETWEEN; i++) {
      const t = i / BETWEEN;
      curve.push([0, 1, 2].map((x) => b[x] + 0.5 * t * (c[x] - a[x] + t * (2 * a[x] - 5 * b[x]
        + 4 * c[x] - d[x] + t * (3 * (b[x] - c[x]) + d[x] - a[x])))));
    }
  }
  return [...curve, points[points.length - 1]];
}

// The nearest points of two things, each a list of points.
function nearest(first, second) {
  let best = null;
  for (const a of first) for (const b of second) {
    const distance = norm(subtract(a, b));
    if (!best || distance < best.distance) best = { distance, ends: [a, b] };
  }
  return best;
}

// Shapes are lists of corners, three for a triangle: position, normal and colour of each.

// With two sides a tube is a flat ribbon.
function tube(mesh, points, radius, colour, sides = SIDES) {
  let before = null;
  points.forEach((point, k) => {
    const along = unit(subtract(points[Math.min(k + 1, points.length - 1)], points[Math.max(k - 1, 0)]));
    const side = unit(cross(along, Math.abs(along[2]) > 0.95 ? [1, 0, 0] : [0, 0, 1]));
    const up = cross(side, along);
    const ring = Array.from({ length: sides }, (_, i) => {
      const angle = (2 * Math.PI * i) / sides;
      const out = add(add([0, 0, 0], side, Math.cos(angle)), up, Math.sin(angle));
      return [...add(point, out, radius), ...out, ...colour];
    });
    for (let i = 0; before && i < sides; i++) {
      const j = (i + 1) % sides;
      mesh.push(before[i], before[j], ring[i], ring[i], before[j], ring[j]);
    }
    before = ring;
  });
}

function disc(mesh, centre, radius, colour, corners = 14) {
  const up = [0, 0, 1];
  const rim = (i) => {
    const angle = (2 * Math.PI * i) / corners;
    return [...add(centre, [radius * Math.cos(angle), radius * Math.sin(angle), 0]), ...up, ...colour];
  };
  for (let i = 0; i < corners; i++) mesh.push([...centre, ...up, ...colour], rim(i), rim(i + 1));
}

function quadrotor(mesh, grip, data, thin, colour, rotor) {
  const hub = add(grip, [0, 0, data.grip]);
  if (data.grip > 0) tube(mesh, [grip, hub], 0.6 * thin, colour);
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const end = add(hub, [0.42 * data.radius * x, 0.42 * data.radius * y, 0]);
    tube(mesh, [hub, end], thin, colour);
    disc(mesh, add(end, [0, 0, 0.05 * data.radius]), 0.38 * data.radius, rotor);
  }
}

function scene(data, frame, highlighted, distance) {
  const mesh = [];
  const radius = Math.max(data.cable, THINNEST * distance);
  const faded = (colour) => (highlighted ? mix(colour, PAPER, 0.55) : colour);
  const marked = (kind, k) =>
    highlighted && highlighted.things.some((one) => one.kind === kind && one.index === k);
  frame.strands.forEach((points, k) => {
    if (!points) return;
    const curve = smooth(points);
    tube(mesh, curve, radius, marked("segment", k) ? ALARM : faded(data.colours[k]));
    tube(mesh, points.map(floored), 0.5 * radius, FAINT, 2);
  });
  frame.vehicles.forEach((grip, k) => {
    if (!grip) return;
    const red = marked("vehicle", k);
    quadrotor(mesh, grip, data, 0.8 * radius, red ? ALARM : faded(INK), red ? ALARM : faded(ROTOR));
    disc(mesh, floored(grip), 0.5 * data.radius, FAINT);
  });
  if (highlighted && highlighted.nearest) tube(mesh, highlighted.nearest.ends, 0.6 * radius, INK);
  const corners = new Float32Array(9 * mesh.length);
  mesh.forEach((corner, k) => corners.set(corner, 9 * k));
  return corners;
}

// The grid of the floor, and the edges of fence and obstacles, as strips.
function fieldLines(reach, spacing, strips) {
  const half = Math.ceil(reach / spacing);
  const colour = mix(FAINT, PAPER, 0.4);
  const corners = [];
  for (let i = -half; i <= half; i++) {
    const at = i * spacing, end = half * spacing;
    for (const [x, y] of [[at, -end], [at, end], [-end, at], [end, at]]) {
      corners.push(x, y, 0, 0, 0, 1, ...colour);
    }
  }
  for (const strip of strips) strip.slice(1).forEach((end, k) => {
    for (const p of [strip[k], end]) corners.push(...p, 0, 0, 1, ...EDGE);
  });
  return new Float32Array(corners);
}
