// Camera and painter of the shapes of motion_scene.js: WebGL 1, without a library.

const FIELD_OF_VIEW = 0.6; // radians; a long lens, so that near strands do not look much thicker

const VERTEX = `attribute vec3 place, normal, colour; uniform mat4 view; uniform vec3 light;
varying vec3 shade; void main() { gl_Position = view * vec4(place, 1.0);
  shade = colour * (0.62 + 0.38 * abs(dot(normal, light))); }`;
const FRAGMENT = `precision mediump float; varying vec3 shade;
void main() { gl_FragColor = vec4(shade, 1.0); }`;

function painter(canvas) {
  // The buffer is kept, so that the picture can be saved by the browser's menu.
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return null;
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  ["place", "normal", "colour"].forEach((name, k) => {
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 36, 12 * k);
  });
  gl.enable(gl.DEPTH_TEST);
  return (matrix, light, lines, triangles) => {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...PAPER, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, matrix);
    gl.uniform3fv(gl.getUniformLocation(program, "light"), light);
    for (const [kind, corners] of [[gl.LINES, lines], [gl.TRIANGLES, triangles]]) {
      gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STREAM_DRAW);
      gl.drawArrays(kind, 0, corners.length / 9);
    }
  };
}

// Returns the eye, and the matrix of the camera: perspective times view, column by column.
function camera(target, yaw, pitch, distance, aspect) {
  const back = [Math.cos(pitch) * Math.sin(yaw), -Math.cos(pitch) * Math.cos(yaw), Math.sin(pitch)];
  const right = [Math.cos(yaw), Math.sin(yaw), 0];
  const up = cross(back, right);
  const eye = add(target, back, distance);
  const f = 1 / Math.tan(FIELD_OF_VIEW / 2), near = 0.05 * distance, far = 20 * distance;
  const depth = (far + near) / (near - far);
  const rows = [[...right, -dot(right, eye)], [...up, -dot(up, eye)], [...back, -dot(back, eye)]];
  const matrix = [0, 1, 2, 3].flatMap((k) => [
    (f / aspect) * rows[0][k], f * rows[1][k],
    depth * rows[2][k] + (k === 3 ? (2 * far * near) / (near - far) : 0), -rows[2][k],
  ]);
  return { eye, back, matrix: new Float32Array(matrix) };
}

function onCanvas(matrix, p, canvas) {
  const [x, y, , w] = [0, 1, 2, 3].map((row) =>
    matrix[row] * p[0] + matrix[4 + row] * p[1] + matrix[8 + row] * p[2] + matrix[12 + row]);
  return w <= 0 ? null : [(0.5 + x / w / 2) * canvas.width, (0.5 - y / w / 2) * canvas.height];
}

// Turns a picture with a finger or the mouse, and magnifies it with two fingers or the wheel.
function gestures(canvas, turn, magnify) {
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (fingers.size < 2) fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const wide = fingers.size === 2 && spread();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (wide) magnify(spread() / wide);
    else turn((event.clientX - before[0]) / 150, (event.clientY - before[1]) / 150);
  });
  for (const ending of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(ending, (event) => fingers.delete(event.pointerId));
  }
  // A page that is scrolled with the wheel must not stop at the picture.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    magnify(Math.exp(-event.deltaY / 500));
  }, { passive: false });
}
