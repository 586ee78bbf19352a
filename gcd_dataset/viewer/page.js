"use strict";
// One garment: its pattern as SVG beside its mesh in WebGL 2. Positions in cm, y up, the wearer faces +z.
// Stages of the slider: 0 panels laid flat, 1 placed round the body, 2 draped.

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const FIELD_OF_VIEW = 0.5; // rad
const SHEET_DISTANCE = 34; // cm from the wearer's axis to the sheet with the flat panels
const LEAST_FRAME = 64; // cm that the camera shows at least
const SEAM_REACH = 7; // pixels between pointer and seam
const SEAM_DEPTH = 1.5; // cm by which a seam under the pointer may lie behind the cloth
const FROM_THE_SIDE = 0.36; // rad: the first view of the placed and the draped garment
const TURN = 0.0085; // rad per pixel
const TILT = [-1.45, 1.45]; // rad
const ZOOM = [0.08, 4];
const SHEET_ZOOM = 16; // largest magnification of the drawing
const PIXELS_FOR_NUMBERS = 9; // pixels per cm from which seam numbers are legible

const state = { stage: 0, body: true, colours: "panels", lit: null, pinned: null, yaw: 0, pitch: 0.06, zoom: 1, pan: [0, 0, 0] };

// ------------------------------------------------------------------------------------------------------------ arrays

/** Integers from base64 of deflated byte planes of differences; rows of `columns` numbers. */
async function integers(packed) {
  const raw = Uint8Array.from(atob(packed.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const { size, columns } = packed;
  const count = bytes.length / size;
  const values = size === 4 ? new Uint32Array(count) : new Uint16Array(count);
  for (let i = 0; i < count; i++) {
    let value = 0;
    for (let plane = 0; plane < size; plane++) value += bytes[plane * count + i] * 2 ** (8 * plane);
    values[i] = i < columns ? value : values[i - columns] + value;
  }
  return values;
}

/** Numbers of a grid: `low[column] + step * integer`. */
async function numbers(packed) {
  const whole = await integers(packed);
  return Float32Array.from(whole, (value, i) => packed.low[i % packed.columns] + packed.step * value);
}

async function decoded(value) {
  if (Array.isArray(value)) return value;
  if (value === null || typeof value !== "object") return value;
  if ("data" in value && "size" in value) return "step" in value ? numbers(value) : integers(value);
  const entries = await Promise.all(Object.entries(value).map(async ([key, part]) => [key, await decoded(part)]));
  return Object.fromEntries(entries);
}

// ------------------------------------------------------------------------------------------------------------ vectors

const mix = (a, b, t) => a + (b - a) * t;
const mix3 = (a, b, t) => [mix(a[0], b[0], t), mix(a[1], b[1], t), mix(a[2], b[2], t)];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / Math.hypot(...a));
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
const smooth = (low, high, value) => {
  const t = clamp((value - low) / (high - low), 0, 1);
  return t * t * (3 - 2 * t);
};

/** Rotation by `share` of the rotation vector [rad], as the three columns of its matrix. */
function rotation(vector, share) {
  const full = Math.hypot(...vector);
  const [x, y, z] = full > 1e-9 ? scaled(vector, 1 / full) : [0, 0, 1];
  const c = Math.cos(full * share);
  const s = Math.sin(full * share);
  const d = 1 - c;
  return [
    [c + x * x * d, y * x * d + z * s, z * x * d - y * s],
    [x * y * d - z * s, c + y * y * d, z * y * d + x * s],
    [x * z * d + y * s, y * z * d - x * s, c + z * z * d],
  ];
}

/** Normals of vertices [unit]: sums over faces by area, and over corners of one vertex where `vertexOf` is given. */
function normalsOf(positions, faces, out, vertexOf, sums) {
  out.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f];
    const b = 3 * faces[f + 1];
    const c = 3 * faces[f + 2];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    for (const corner of [a, b, c]) {
      out[corner] += nx;
      out[corner + 1] += ny;
      out[corner + 2] += nz;
    }
  }
  if (vertexOf) {
    sums.fill(0);
    for (let i = 0; i < out.length; i++) sums[3 * vertexOf[Math.floor(i / 3)] + (i % 3)] += out[i];
    for (let i = 0; i < out.length; i++) out[i] = sums[3 * vertexOf[Math.floor(i / 3)] + (i % 3)];
  }
  for (let i = 0; i < out.length; i += 3) {
    const length = Math.hypot(out[i], out[i + 1], out[i + 2]) || 1;
    out[i] /= length;
    out[i + 1] /= length;
    out[i + 2] /= length;
  }
}

function boundsOf(positions) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    low[i % 3] = Math.min(low[i % 3], positions[i]);
    high[i % 3] = Math.max(high[i % 3], positions[i]);
  }
  return { low, high };
}

// ------------------------------------------------------------------------------------------------------------- garment

/** The mesh at any stage: positions of corners (panel by panel, split at seams), normals, ends of seam segments. */
class Garment {
  constructor(mesh, panels) {
    Object.assign(this, mesh);
    this.panels = panels;
    this.count = mesh.vertexOf.length;
    this.last = mesh.draped ? 2 : 1;
    this.positions = new Float32Array(3 * this.count);
    this.normals = new Float32Array(3 * this.count);
    this.sums = new Float32Array(mesh.placed.length);
    this.ends = new Float32Array(2 * 3 * mesh.segmentSeam.length);
    this.sheet = new Float32Array(3 * this.count);
    const { low, high } = boundsOf(mesh.placed);
    const body = data.mesh.floor === null ? low[1] : data.mesh.floor;
    const [width, height] = data.mesh.sheetSize;
    const bottom = Math.max(body, 0.5 * (low[1] + high[1]) - 0.5 * height);
    for (let i = 0; i < this.count; i++) {
      const shift = panels[mesh.panelOf[i]].shift;
      this.sheet[3 * i] = mesh.flat[2 * i] + shift[0] - 0.5 * width;
      this.sheet[3 * i + 1] = mesh.flat[2 * i + 1] + shift[1] + bottom;
      this.sheet[3 * i + 2] = SHEET_DISTANCE;
    }
    this.centres = panels.map(() => [0, 0, 0, 0, 0, 0, 0]); // sheet (3), placed (3), number of corners
    for (let i = 0; i < this.count; i++) {
      const sum = this.centres[mesh.panelOf[i]];
      for (let k = 0; k < 3; k++) {
        sum[k] += this.sheet[3 * i + k];
        sum[3 + k] += mesh.placed[3 * mesh.vertexOf[i] + k];
      }
      sum[6] += 1;
    }
    for (const sum of this.centres) for (let k = 0; k < 6; k++) sum[k] /= sum[6] || 1;
    this.stages = [0, 1, 2].slice(0, this.last + 1);
    this.frames = this.stages.map((stage) => {
      this.moveTo(stage);
      return boundsOf(this.positions);
    });
  }

  moveTo(stage) {
    const { positions, vertexOf, panelOf, sheet, placed, draped } = this;
    if (stage >= 1) {
      const share = draped ? stage - 1 : 0;
      for (let i = 0; i < this.count; i++) {
        for (let k = 0; k < 3; k++) {
          const at = 3 * vertexOf[i] + k;
          positions[3 * i + k] = share ? mix(placed[at], draped[at], share) : placed[at];
        }
      }
    } else {
      // Panels turn rigidly; what is left, the bends at seams, fades in.
      const share = smooth(0, 1, stage);
      const part = this.panels.map((panel) => rotation(panel.turn, share));
      const whole = this.panels.map((panel) => rotation(panel.turn, 1));
      for (let i = 0; i < this.count; i++) {
        const p = panelOf[i];
        const c = this.centres[p];
        const x = sheet[3 * i] - c[0];
        const y = sheet[3 * i + 1] - c[1];
        for (let k = 0; k < 3; k++) {
          const bend = placed[3 * vertexOf[i] + k] - c[3 + k] - (whole[p][0][k] * x + whole[p][1][k] * y);
          positions[3 * i + k] = mix(c[k], c[3 + k], share) + part[p][0][k] * x + part[p][1][k] * y + share * bend;
        }
      }
    }
    normalsOf(positions, this.corners, this.normals, stage >= 1 ? vertexOf : null, this.sums);
    for (let i = 0; i < this.segments.length; i++) {
      const from = 3 * this.segments[i];
      this.ends.set(positions.subarray(from, from + 3), 3 * i);
    }
  }

  /** Centre and size of what the camera shows at a stage [cm]. */
  frame(stage) {
    const before = Math.min(Math.floor(stage), this.last);
    const after = Math.min(before + 1, this.last);
    const t = smooth(0, 1, stage - before);
    const low = mix3(this.frames[before].low, this.frames[after].low, t);
    const high = mix3(this.frames[before].high, this.frames[after].high, t);
    return { centre: mix3(low, high, 0.5), size: sub(high, low) };
  }
}

// --------------------------------------------------------------------------------------------------------------- WebGL

const SURFACE = [
  `#version 300 es
  layout(location=0) in vec3 position; layout(location=1) in vec3 normal;
  layout(location=2) in vec3 colour; layout(location=3) in float part;
  uniform mat4 view; uniform vec2 lit; uniform vec3 dimmed;
  out vec3 n; out vec3 shade; out vec3 where;
  void main() {
    n = normal; where = position; shade = colour;
    if (lit.x >= 0.0) shade = part == lit.x || part == lit.y ? mix(colour, vec3(1.0), 0.06) : mix(colour, dimmed, 0.72);
    gl_Position = view * vec4(position, 1.0);
  }`,
  `#version 300 es
  precision highp float;
  in vec3 n; in vec3 shade; in vec3 where;
  uniform vec3 eye; uniform vec3 key; uniform float inside; uniform float opacity;
  out vec4 colour;
  void main() {
    vec3 toEye = normalize(eye - where);
    vec3 m = normalize(n) * (gl_FrontFacing ? 1.0 : -1.0);
    if (dot(m, toEye) < -0.2) m = -m;
    float sky = 0.5 + 0.5 * m.y;
    float light = 0.45 + 0.20 * sky + 0.44 * max(dot(m, key), 0.0) + 0.10 * max(dot(m, toEye), 0.0);
    float rim = pow(1.0 - max(dot(m, toEye), 0.0), 3.0);
    vec3 base = pow(shade, vec3(2.2));
    if (!gl_FrontFacing) base *= inside;
    vec3 linear = base * light * light + 0.03 * rim;
    colour = vec4(pow(linear, vec3(1.0 / 2.2)), opacity);
  }`,
];

const LINES = [
  `#version 300 es
  layout(location=0) in vec3 start; layout(location=1) in vec3 end;
  layout(location=2) in vec3 colour; layout(location=3) in float seam; layout(location=4) in float side;
  uniform mat4 view; uniform vec3 eye; uniform vec2 pixels; uniform float width; uniform float lit; uniform vec3 accent;
  uniform vec2 panels; uniform vec3 dimmed;
  out vec3 shade;
  vec4 project(vec3 p) { return view * vec4(p + normalize(eye - p) * (seam == lit && lit >= 0.0 ? 0.5 : 0.25), 1.0); }
  void main() {
    bool isLit = lit >= 0.0 && seam == lit;
    vec4 a = project(start), b = project(end);
    vec2 run = (b.xy / b.w - a.xy / a.w) * pixels;
    vec2 along = length(run) > 1e-5 ? normalize(run) : vec2(1.0, 0.0);
    vec2 across = vec2(-along.y, along.x);
    float half_ = 0.5 * width * (isLit ? 3.0 : seam < 0.0 ? 0.7 : 1.0);
    vec4 p = gl_VertexID < 2 ? a : b;
    vec2 offset = across * half_ * (gl_VertexID % 2 == 0 ? 1.0 : -1.0) + along * half_ * (gl_VertexID < 2 ? -0.5 : 0.5);
    p.xy += offset / pixels * p.w;
    shade = isLit ? accent : colour;
    if (!isLit && panels.x >= 0.0 && side != panels.x && side != panels.y) shade = mix(colour, dimmed, 0.75);
    gl_Position = p;
  }`,
  `#version 300 es
  precision highp float;
  in vec3 shade; uniform float opacity; out vec4 colour;
  void main() { colour = vec4(shade, opacity); }`,
];

const FLOOR = [
  `#version 300 es
  uniform mat4 view; uniform vec4 disc;
  out vec2 at;
  void main() {
    at = vec2(gl_VertexID % 2 == 0 ? -1.0 : 1.0, gl_VertexID < 2 ? -1.0 : 1.0);
    gl_Position = view * vec4(disc.x + at.x * disc.w, disc.y, disc.z + at.y * disc.w, 1.0);
  }`,
  `#version 300 es
  precision highp float;
  in vec2 at; uniform float strength; out vec4 colour;
  void main() {
    float r = length(at);
    float fall = clamp(1.0 - r, 0.0, 1.0);
    float ring = smoothstep(0.012, 0.0, abs(r - 0.96)) * 0.5;
    colour = vec4(vec3(0.0), strength * (fall * fall * 0.9) + strength * ring);
  }`,
];

class Picture {
  constructor(canvas, garment, body, floor) {
    this.canvas = canvas;
    this.garment = garment;
    this.body = body;
    this.floor = floor;
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false });
    if (!gl) throw new Error("WebGL 2 is not available in this browser");
    this.gl = gl;
    [this.surface, this.lines, this.disc] = [SURFACE, LINES, FLOOR].map((sources) => this.program(...sources));
    this.buffers = {
      position: this.buffer(garment.positions.byteLength),
      normal: this.buffer(garment.normals.byteLength),
      colour: this.buffer(3 * garment.count),
      ends: this.buffer(garment.ends.byteLength),
    };
    const part = this.buffer(Float32Array.from(garment.panelOf));
    const elements = this.buffer(garment.corners, gl.ELEMENT_ARRAY_BUFFER);
    this.cloth = this.vertexArray(
      [[0, this.buffers.position, 3], [1, this.buffers.normal, 3], [2, this.buffers.colour, 3, gl.UNSIGNED_BYTE], [3, part, 1]],
      elements,
    );
    const seams = garment.segmentSeam;
    const colours = new Uint8Array(3 * seams.length);
    seams.forEach((seam, i) => colours.set(seam < data.seams.length ? data.seams[seam].colour : data.plainEdge, 3 * i));
    const numbers = Float32Array.from(seams, (seam) => (seam < data.seams.length ? seam : -1));
    const sides = Float32Array.from(seams, (_, i) => garment.panelOf[garment.segments[2 * i]]);
    this.seams = this.vertexArray([
      [0, this.buffers.ends, 3, gl.FLOAT, 24, 0, 1], [1, this.buffers.ends, 3, gl.FLOAT, 24, 12, 1],
      [2, this.buffer(colours), 3, gl.UNSIGNED_BYTE, 0, 0, 1], [3, this.buffer(numbers), 1, gl.FLOAT, 0, 0, 1],
      [4, this.buffer(sides), 1, gl.FLOAT, 0, 0, 1],
    ]);
    if (body) {
      body.normals = new Float32Array(body.vertices.length);
      normalsOf(body.vertices, body.faces, body.normals);
      const skin = this.buffer(new Uint8Array(body.vertices.length).fill(255));
      this.skin = this.vertexArray(
        [[0, this.buffer(body.vertices), 3], [1, this.buffer(body.normals), 3], [2, skin, 3, gl.UNSIGNED_BYTE]],
        this.buffer(body.faces, gl.ELEMENT_ARRAY_BUFFER),
      );
    }
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(...sources) {
    const { gl } = this;
    const program = gl.createProgram();
    [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, i) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, sources[i]);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    });
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  buffer(content, target = this.gl.ARRAY_BUFFER) {
    const buffer = this.gl.createBuffer();
    this.gl.bindVertexArray(null);
    this.gl.bindBuffer(target, buffer);
    this.gl.bufferData(target, content, typeof content === "number" ? this.gl.DYNAMIC_DRAW : this.gl.STATIC_DRAW);
    return buffer;
  }

  vertexArray(attributes, elements = null) {
    const { gl } = this;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [place, buffer, size, type = gl.FLOAT, stride = 0, offset = 0, divisor = 0] of attributes) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, stride, offset);
      gl.vertexAttribDivisor(place, divisor);
    }
    if (elements) gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
    gl.bindVertexArray(null);
    return array;
  }

  upload(buffer, content) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, buffer);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, content);
  }

  move(stage) {
    this.garment.moveTo(stage);
    this.upload(this.buffers.position, this.garment.positions);
    this.upload(this.buffers.normal, this.garment.normals);
    this.upload(this.buffers.ends, this.garment.ends);
  }

  /** Eye, axes and projection of the camera for the present state. */
  camera() {
    const { centre, size } = this.garment.frame(state.stage);
    const aspect = this.canvas.width / this.canvas.height;
    const slope = Math.tan(0.5 * FIELD_OF_VIEW);
    const solid = smooth(0, 1, state.stage);
    const yaw = state.yaw + FROM_THE_SIDE * solid;
    const { pitch } = state;
    const width = mix(size[0], Math.max(size[0], size[2]), solid);
    const reach = 0.5 * Math.max(size[1], width / aspect, LEAST_FRAME);
    const distance = (reach / slope) * mix(1.1, 1.2, solid) * state.zoom + 0.5 * size[2];
    const back = [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)];
    const right = [Math.cos(yaw), 0, -Math.sin(yaw)];
    const up = cross(back, right);
    const eye = add(add(centre, state.pan), scaled(back, distance));
    const [near, far] = [Math.max(1, 0.02 * distance), distance + 900];
    const rows = [
      [...scaled(right, 1 / (slope * aspect)), -dot(right, eye) / (slope * aspect)],
      [...scaled(up, 1 / slope), -dot(up, eye) / slope],
      [...scaled(back, -(far + near) / (far - near)), (dot(back, eye) * (far + near) - 2 * far * near) / (far - near)],
      [...scaled(back, -1), dot(back, eye)],
    ];
    const view = new Float32Array(16);
    rows.forEach((row, r) => row.forEach((value, c) => (view[4 * c + r] = value)));
    return { eye, back, right, up, view, slope, aspect, distance };
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((n) => Math.max(1, Math.round(n * ratio)));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    return ratio;
  }

  draw() {
    const { gl, garment } = this;
    const ratio = this.resize();
    const camera = this.camera();
    const theme = themeColours();
    const lit = litPanels();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.BLEND);

    const use = (program, values) => {
      gl.useProgram(program.program);
      for (const [name, value] of Object.entries(values)) {
        const place = program.places[name];
        if (place === undefined) continue;
        if (value.length === 16) gl.uniformMatrix4fv(place, false, value);
        else if (value.length) gl[`uniform${value.length}fv`](place, value);
        else gl.uniform1f(place, value);
      }
    };
    const key = unit(add(add(scaled(camera.back, 0.75), scaled(camera.up, 0.55)), scaled(camera.right, -0.55)));
    const common = { view: camera.view, eye: camera.eye, key, lit: [-1, -1], dimmed: theme.dimmed };
    const presence = smooth(0.35, 0.95, state.stage);

    if (this.floor !== null) {
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.bindVertexArray(null);
      use(this.disc, { view: camera.view, disc: [0, this.floor, 0, 62], strength: theme.shadow * (state.body ? presence : 0) });
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }
    if (this.skin && state.body && presence > 0.02) {
      gl.bindVertexArray(this.skin);
      gl.disableVertexAttribArray(3);
      gl.vertexAttrib1f(3, -1);
      gl.disableVertexAttribArray(2);
      gl.vertexAttrib3f(2, ...theme.skin);
      use(this.surface, { ...common, inside: 1, opacity: presence });
      if (presence < 1) {
        gl.colorMask(false, false, false, false);
        this.elements(this.body.faces);
        gl.colorMask(true, true, true, true);
        gl.enable(gl.BLEND);
      }
      this.elements(this.body.faces);
      gl.disable(gl.BLEND);
    }
    gl.bindVertexArray(this.cloth);
    use(this.surface, { ...common, lit, inside: mix(1, 0.62, presence), opacity: 1 });
    this.elements(garment.corners);

    gl.bindVertexArray(this.seams);
    const seam = state.lit && state.lit.kind === "seam" ? state.lit.number : -1;
    const lines = {
      view: camera.view, eye: camera.eye, pixels: [this.canvas.width / 2, this.canvas.height / 2],
      width: 1.7 * ratio, lit: seam, accent: theme.accent, panels: lit, dimmed: theme.dimmed, opacity: 1,
    };
    use(this.lines, lines);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, garment.segmentSeam.length);
    if (seam >= 0) this.drawHidden(lines, seam, use);
    gl.bindVertexArray(null);
  }

  /** The lit seam through the cloth that hides it, faintly. */
  drawHidden(lines, seam, use) {
    const { gl, garment } = this;
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    use(this.lines, { ...lines, opacity: 0.28 });
    const runs = garment.runs.get(seam) || [];
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.ends);
    for (const [first, count] of runs) {
      [0, 12].forEach((part, place) => gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, 24 * first + part));
      for (const place of [2, 3, 4]) gl.disableVertexAttribArray(place);
      gl.vertexAttrib3f(2, 0, 0, 0);
      gl.vertexAttrib1f(3, seam);
      gl.vertexAttrib1f(4, -1);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    }
    for (const place of [2, 3, 4]) gl.enableVertexAttribArray(place);
    [0, 12].forEach((part, place) => gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, part));
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
  }

  elements(indices) {
    const { gl } = this;
    gl.drawElements(gl.TRIANGLES, indices.length, indices.BYTES_PER_ELEMENT === 4 ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
  }

  /** The seam or panel at a point of the canvas [CSS pixels]; null for the background and the body. */
  pick(x, y) {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const camera = this.camera();
    const { eye, back, right, up, slope, aspect } = camera;
    const sideways = scaled(right, ((2 * x) / width - 1) * slope * aspect);
    const ray = unit(add(add(scaled(back, -1), sideways), scaled(up, (1 - (2 * y) / height) * slope)));
    const cloth = nearestHit(eye, ray, this.garment.positions, this.garment.corners);
    const skin = this.skin && state.body && state.stage > 0.6 ? nearestHit(eye, ray, this.body.vertices, this.body.faces) : null;
    const depth = Math.min(cloth ? cloth.distance : Infinity, skin ? skin.distance : Infinity);
    const seam = this.seamAt(x, y, camera, width, height, depth);
    if (seam !== null) return { kind: "seam", number: seam };
    if (!cloth || cloth.distance > depth) return null;
    return { kind: "panel", number: this.garment.panelOf[this.garment.corners[3 * cloth.face]] };
  }

  seamAt(x, y, { eye, view }, width, height, depth) {
    const { ends, segmentSeam } = this.garment;
    const points = new Float32Array(4);
    let best = SEAM_REACH;
    let found = null;
    for (let s = 0; s < segmentSeam.length; s++) {
      if (segmentSeam[s] >= data.seams.length) continue;
      let far = 0;
      for (let side = 0; side < 2; side++) {
        const [px, py, pz] = ends.subarray(6 * s + 3 * side, 6 * s + 3 * side + 3);
        const w = view[3] * px + view[7] * py + view[11] * pz + view[15];
        points[2 * side] = ((view[0] * px + view[4] * py + view[8] * pz + view[12]) / w + 1) * 0.5 * width;
        points[2 * side + 1] = (1 - (view[1] * px + view[5] * py + view[9] * pz + view[13]) / w) * 0.5 * height;
        far = Math.max(far, Math.hypot(px - eye[0], py - eye[1], pz - eye[2]));
      }
      const [dx, dy] = [points[2] - points[0], points[3] - points[1]];
      const t = clamp(((x - points[0]) * dx + (y - points[1]) * dy) / (dx * dx + dy * dy || 1), 0, 1);
      const away = Math.hypot(x - points[0] - t * dx, y - points[1] - t * dy);
      if (away < best && far < depth + SEAM_DEPTH) [best, found] = [away, segmentSeam[s]];
    }
    return found;
  }
}

/** The first face that a ray meets (Möller and Trumbore 1997). */
function nearestHit(eye, ray, positions, faces) {
  let distance = Infinity;
  let face = -1;
  const [ox, oy, oz] = eye;
  const [dx, dy, dz] = ray;
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f];
    const b = 3 * faces[f + 1];
    const c = 3 * faces[f + 2];
    const ax = positions[a];
    const ay = positions[a + 1];
    const az = positions[a + 2];
    const ux = positions[b] - ax;
    const uy = positions[b + 1] - ay;
    const uz = positions[b + 2] - az;
    const vx = positions[c] - ax;
    const vy = positions[c + 1] - ay;
    const vz = positions[c + 2] - az;
    const px = dy * vz - dz * vy;
    const py = dz * vx - dx * vz;
    const pz = dx * vy - dy * vx;
    const determinant = ux * px + uy * py + uz * pz;
    if (Math.abs(determinant) < 1e-12) continue;
    const tx = ox - ax;
    const ty = oy - ay;
    const tz = oz - az;
    const u = (tx * px + ty * py + tz * pz) / determinant;
    if (u < 0 || u > 1) continue;
    const qx = ty * uz - tz * uy;
    const qy = tz * ux - tx * uz;
    const qz = tx * uy - ty * ux;
    const v = (dx * qx + dy * qy + dz * qz) / determinant;
    if (v < 0 || u + v > 1) continue;
    const t = (vx * qx + vy * qy + vz * qz) / determinant;
    if (t > 0 && t < distance) [distance, face] = [t, f / 3];
  }
  return face < 0 ? null : { face, distance };
}

// -------------------------------------------------------------------------------------------------------------- colours

function themeColours() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => {
    const hex = style.getPropertyValue(name).trim();
    return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  };
  return {
    accent: colour("--accent"), dimmed: colour("--dimmed"), skin: colour("--skin"), neutral: colour("--neutral"),
    shadow: parseFloat(style.getPropertyValue("--shadow-strength")),
  };
}

const COLD = [0.17, 0.42, 0.72];
const HOT = [0.84, 0.15, 0.16];
const EVEN = [0.93, 0.92, 0.89];

/** Colour of a stretch: blue below 1, pale at 1, red from 1 + range. */
function stretchColour(stretch) {
  const t = clamp((stretch - 1) / data.stretchRange, -1, 1);
  return mix3(EVEN, t < 0 ? COLD : HOT, Math.sqrt(Math.abs(t)));
}

function paintRamp() {
  const stops = [];
  for (let i = 0; i <= 16; i++) {
    const colour = stretchColour(1 + data.stretchRange * (i / 8 - 1)).map((part) => Math.round(255 * part));
    stops.push(`rgb(${colour.join(",")})`);
  }
  $("ramp").style.background = `linear-gradient(90deg, ${stops.join(",")})`;
}

/** RGB bytes of each corner in a mode: panels, strain or crossings. */
function cornerColours(garment, mode) {
  const bytes = new Uint8Array(3 * garment.count);
  const neutral = themeColours().neutral;
  const crossed = new Set(mode === "crossings" && garment.crossed ? garment.crossed : []);
  for (let i = 0; i < garment.count; i++) {
    const colour =
      mode === "strain" ? stretchColour(garment.stretch[i])
      : mode === "crossings" ? (crossed.has(garment.vertexOf[i]) ? HOT : neutral)
      : garment.panels[garment.panelOf[i]].colour.map((part) => part / 255);
    for (let k = 0; k < 3; k++) bytes[3 * i + k] = Math.round(255 * colour[k]);
  }
  return bytes;
}

// ---------------------------------------------------------------------------------------------------------- highlights

let picture = null;
let pending = 0;

function redraw() {
  if (!picture || pending) return;
  pending = requestAnimationFrame(() => {
    pending = 0;
    picture.draw();
  });
}

/** The two panels that stay coloured: the lit one, or those of the lit seam; -1 where nothing is lit. */
function litPanels() {
  if (!state.lit) return [-1, -1];
  return state.lit.kind === "panel" ? [state.lit.number, state.lit.number] : data.seams[state.lit.number].panels;
}

const same = (a, b) => (a && b ? a.kind === b.kind && a.number === b.number : a === b);

/** Light a panel or a seam in both views; null for none. */
function light(part) {
  part = part || state.pinned;
  if (same(part, state.lit)) return;
  state.lit = part;
  const svg = document.querySelector("#pattern svg");
  const panels = litPanels();
  svg.classList.toggle("has-lit", Boolean(part));
  svg.querySelectorAll("[data-panel]").forEach((group, i) => group.classList.toggle("lit", panels.includes(i)));
  svg.querySelectorAll(".edge").forEach((edge) => {
    edge.classList.toggle("lit", Boolean(part) && part.kind === "seam" && Number(edge.dataset.seam) === part.number);
  });
  $("readout").textContent = part ? (part.kind === "panel" ? data.panels : data.seams)[part.number].text : $("readout").dataset.hint;
  $("parts").value = part ? `${part.kind}:${part.number}` : "";
  document.body.dataset.lit = part ? `${part.kind}:${part.number}` : "";
  redraw();
}

/** Keep a part lit after the pointer leaves; a second time, or null, lets it go. */
function pin(part) {
  state.pinned = same(part, state.pinned) ? null : part;
  state.lit = undefined;
  light(state.pinned);
}

function preparePattern() {
  const svg = document.querySelector("#pattern svg");
  svg.querySelectorAll("title").forEach((title) => title.remove());
  const groups = [...svg.querySelectorAll("[data-panel]")];
  groups.forEach((group, number) => {
    const panel = { kind: "panel", number };
    group.setAttribute("role", "button");
    group.setAttribute("aria-label", `panel ${data.panels[number].text}`);
    group.setAttribute("tabindex", number === 0 ? "0" : "-1");
    group.firstElementChild.classList.add("cloth");
    group.firstElementChild.style.setProperty("--panel", `rgb(${data.panels[number].colour})`);
    group.addEventListener("pointerenter", () => light(panel));
    group.addEventListener("focus", () => light(panel));
    group.addEventListener("blur", () => light(null));
    group.addEventListener("click", () => pin(panel));
    group.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (step) {
        const next = groups[(number + step + groups.length) % groups.length];
        groups.forEach((other) => other.setAttribute("tabindex", other === next ? "0" : "-1"));
        next.focus();
      } else if (event.key === "Enter" || event.key === " ") {
        pin(panel);
      } else {
        return;
      }
      event.preventDefault();
    });
    group.querySelectorAll("[data-edge]").forEach((edge) => {
      edge.classList.add("edge");
      if (!("seam" in edge.dataset)) return;
      const seam = { kind: "seam", number: Number(edge.dataset.seam) };
      const reach = edge.cloneNode();
      reach.classList.replace("edge", "reach");
      reach.removeAttribute("data-edge");
      group.append(reach);
      reach.addEventListener("pointerenter", () => light(seam));
      reach.addEventListener("pointerleave", () => light(panel));
      reach.addEventListener("click", (event) => {
        pin(seam);
        event.stopPropagation();
      });
    });
  });
  svg.addEventListener("pointerleave", () => light(null));
  svg.addEventListener("click", (event) => event.target === svg && state.pinned && pin(null));
  prepareSheet(svg);
}

/** Wheel and pinch zoom the drawing, dragging moves it, a double click shows all of it. */
function prepareSheet(svg) {
  const whole = svg.getAttribute("viewBox").split(" ").map(Number);
  let box = [...whole];
  const show = (next) => {
    box = next;
    svg.setAttribute("viewBox", box.join(" "));
    svg.classList.toggle("close", svg.getScreenCTM().a > PIXELS_FOR_NUMBERS);
  };
  const zoomAt = (event, factor) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const size = clamp(box[2] * factor, whole[2] / SHEET_ZOOM, whole[2]);
    if (size === whole[2]) return show([...whole]);
    const share = size / box[2];
    return show([mix(at.x, box[0], share), mix(at.y, box[1], share), size, box[3] * share]);
  };
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomAt(event, wheelFactor(event));
  }, { passive: false });
  svg.addEventListener("dblclick", () => show([...whole]));
  const pointers = new Map();
  svg.addEventListener("pointerdown", (event) => pointers.set(event.pointerId, [event.clientX, event.clientY]));
  svg.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before || !event.buttons || box[2] >= whole[2] && pointers.size < 2) return;
    const now = [event.clientX, event.clientY];
    const other = [...pointers].find(([id]) => id !== event.pointerId);
    pointers.set(event.pointerId, now);
    if (other) {
      const spread = (at) => Math.hypot(at[0] - other[1][0], at[1] - other[1][1]);
      zoomAt(event, spread(before) / Math.max(spread(now), 1));
    } else {
      const scale = svg.getScreenCTM().a;
      show([box[0] - (now[0] - before[0]) / scale, box[1] - (now[1] - before[1]) / scale, box[2], box[3]]);
    }
  });
  for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
    svg.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  new ResizeObserver(() => show(box)).observe(svg);
}

/** The zoom of one turn of the wheel, whatever its unit. */
function wheelFactor(event) {
  return Math.exp(clamp(event.deltaY * (event.deltaMode ? 30 : 1), -240, 240) * 0.0014);
}

// ------------------------------------------------------------------------------------------------------------- controls

function setStage(stage) {
  state.stage = clamp(stage, 0, picture.garment.last);
  $("stage").value = state.stage;
  const names = ["laid flat", "placed", "draped"];
  const nearest = Math.round(state.stage);
  const near = Math.abs(state.stage - nearest) < 0.02;
  const text = near ? names[nearest] : `${names[Math.floor(state.stage)]} to ${names[Math.floor(state.stage) + 1]}`;
  $("stage").setAttribute("aria-valuetext", text);
  document.querySelectorAll("[data-stage]").forEach((button) => {
    button.setAttribute("aria-pressed", String(near && Number(button.dataset.stage) === nearest));
  });
  picture.move(state.stage);
  document.body.dataset.stage = state.stage.toFixed(3);
  redraw();
}

let moving = 0;

/** Move the slider to a stage over some time, or at once for people who asked for less motion. */
function glide(target) {
  cancelAnimationFrame(moving);
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return setStage(target);
  const from = state.stage;
  const duration = 900 * Math.abs(target - from);
  let begun = null;
  const step = (now) => {
    begun = begun ?? now;
    const t = duration ? Math.min((now - begun) / duration, 1) : 1;
    setStage(mix(from, target, smooth(0, 1, t)));
    if (t < 1) moving = requestAnimationFrame(step);
  };
  moving = requestAnimationFrame(step);
  return moving;
}

function setColours(mode) {
  state.colours = mode;
  document.querySelectorAll("input[name=colours]").forEach((input) => (input.checked = input.value === mode));
  document.querySelectorAll("[data-legend]").forEach((legend) => (legend.hidden = legend.dataset.legend !== mode));
  picture.upload(picture.buffers.colour, cornerColours(picture.garment, mode));
  redraw();
}

function resetCamera() {
  Object.assign(state, { yaw: 0, pitch: 0.06, zoom: 1, pan: [0, 0, 0] });
  redraw();
}

function turn(dx, dy) {
  state.yaw -= dx;
  state.pitch = clamp(state.pitch + dy, ...TILT);
  redraw();
}

function zoom(factor) {
  state.zoom = clamp(state.zoom * factor, ...ZOOM);
  redraw();
}

function pan(dx, dy) {
  const { right, up, distance, slope } = picture.camera();
  const perPixel = (2 * slope * distance) / picture.canvas.clientHeight;
  state.pan = add(state.pan, add(scaled(right, -dx * perPixel), scaled(up, dy * perPixel)));
  redraw();
}

function prepareCanvas(canvas) {
  const pointers = new Map();
  let travel = 0;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, place(event));
    travel = 0;
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = place(event);
    const before = pointers.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") light(picture.pick(...now));
      return;
    }
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travel += Math.hypot(dx, dy);
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    pointers.set(event.pointerId, now);
    if (others.length) {
      const spread = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]);
      zoom(spread(before) / Math.max(spread(now), 1));
      pan(0.5 * dx, 0.5 * dy);
    } else if (event.buttons & 6 || event.shiftKey) {
      pan(dx, dy);
    } else {
      turn(TURN * dx, TURN * dy);
    }
  });
  const release = (event) => {
    if (pointers.delete(event.pointerId) && travel < 4 && event.type === "pointerup" && event.button === 0) {
      const part = picture.pick(...place(event));
      if (part || state.pinned) pin(part);
    }
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && !pointers.size && light(null));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", resetCamera);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(wheelFactor(event));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => (event.shiftKey ? pan(24, 0) : turn(0.12, 0)), ArrowRight: () => (event.shiftKey ? pan(-24, 0) : turn(-0.12, 0)),
      ArrowUp: () => (event.shiftKey ? pan(0, 24) : turn(0, 0.08)), ArrowDown: () => (event.shiftKey ? pan(0, -24) : turn(0, -0.08)),
      "+": () => zoom(0.88), "=": () => zoom(0.88), "-": () => zoom(1.14), 0: resetCamera, Escape: () => state.pinned && pin(null),
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    keys[event.key]();
    event.preventDefault();
  });
}

function prepareControls() {
  $("stage").max = picture.garment.last;
  $("stage").addEventListener("input", (event) => {
    cancelAnimationFrame(moving);
    setStage(Number(event.target.value));
  });
  document.querySelectorAll("[data-stage]").forEach((button) => {
    button.addEventListener("click", () => glide(Number(button.dataset.stage)));
  });
  document.querySelectorAll("input[name=colours]").forEach((input) => {
    input.addEventListener("change", () => setColours(input.value));
  });
  if ($("body")) {
    $("body").addEventListener("change", (event) => {
      state.body = event.target.checked;
      redraw();
    });
  }
  paintRamp();
  $("reset").addEventListener("click", resetCamera);
}

function prepareScheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const show = () => {
    const chosen = document.documentElement.dataset.scheme;
    $("scheme").setAttribute("aria-pressed", String(chosen ? chosen === "dark" : dark.matches));
    if (picture) setColours(state.colours);
  };
  $("scheme").addEventListener("click", () => {
    const isDark = $("scheme").getAttribute("aria-pressed") === "true";
    document.documentElement.dataset.scheme = isDark ? "light" : "dark";
    show();
  });
  dark.addEventListener("change", show);
  show();
}

async function start() {
  preparePattern();
  $("parts").addEventListener("change", (event) => {
    const [kind, number] = event.target.value.split(":");
    state.pinned = null;
    pin(kind ? { kind, number: Number(number) } : null);
  });
  document.addEventListener("keydown", (event) => event.key === "Escape" && state.pinned && pin(null));
  prepareScheme();
  if (!data.mesh) return;
  try {
    if (typeof DecompressionStream === "undefined") throw new Error("This browser cannot unpack the meshes: update it");
    const [mesh, body] = await Promise.all([decoded(data.mesh), decoded(data.body)]);
    const garment = new Garment(mesh, data.panels);
    garment.runs = runsOf(garment.segmentSeam);
    picture = new Picture($("view"), garment, body, data.mesh.floor);
  } catch (error) {
    $("no-view").textContent = `${error.message}. The pattern and the tables are complete.`;
    $("no-view").hidden = false;
    return;
  }
  prepareCanvas(picture.canvas);
  prepareControls();
  setStage(picture.garment.last);
  setColours("panels");
  new ResizeObserver(redraw).observe(picture.canvas);
  window.gcdPage = { state, picture, setStage, light };
  document.body.dataset.ready = "true";
}

/** Seam to [first, count] of its runs of consecutive segments. */
function runsOf(segmentSeam) {
  const runs = new Map();
  segmentSeam.forEach((seam, i) => {
    const own = runs.get(seam) || [];
    const last = own[own.length - 1];
    if (last && last[0] + last[1] === i) last[1] += 1;
    else own.push([i, 1]);
    runs.set(seam, own);
  });
  return runs;
}

start();
