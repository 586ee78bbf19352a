// The garment and its wearer in WebGL 2: camera, drawing, and what lies under the pointer.

const FIELD_OF_VIEW = 0.5; // rad
const LEAST_FRAME = 64; // cm that the camera shows at least
const SEAM_REACH = 7; // pixels between pointer and seam
const SEAM_DEPTH = 1.5; // cm by which a seam under the pointer may lie behind the cloth
const FROM_THE_SIDE = 0.36; // rad: the first view of the placed and the draped garment

const SURFACE = [
  `#version 300 es
  layout(location=0) in vec3 position; layout(location=1) in vec3 normal;
  layout(location=2) in vec3 colour; layout(location=3) in float part;
  uniform mat4 view; uniform vec2 lit; uniform vec3 dimmed; uniform float shown;
  out vec3 n; out vec3 shade; out vec3 where;
  void main() {
    n = normal; where = position; shade = colour;
    if (lit.x >= 0.0) shade = part == lit.x || part == lit.y ? mix(colour, vec3(1.0), 0.06) : mix(colour, dimmed, 0.72);
    gl_Position = part < shown ? view * vec4(position, 1.0) : vec4(0.0, 0.0, 2.0, 1.0); // clipped: of a garment taken off
  }`,
  `#version 300 es
  precision highp float;
  in vec3 n; in vec3 shade; in vec3 where;
  uniform vec3 eye; uniform vec3 key; uniform float inside; uniform float opacity;
  out vec4 colour;
  void main() {
    vec3 toEye = normalize(eye - where);
    vec3 m = normalize(n) * (gl_FrontFacing ? 1.0 : -1.0);
    m -= 2.0 * min(dot(m, toEye), 0.0) * toEye; // normals of coarse cloth may point away: a jump would show its faces
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
  uniform vec2 panels; uniform vec3 dimmed; uniform float shown;
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
    gl_Position = side < shown ? p : vec4(0.0, 0.0, 2.0, 1.0);
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
      Object.assign(this.buffers, { body: this.buffer(body.vertices), bodyNormal: this.buffer(body.normals) });
      const skin = this.buffer(new Uint8Array(body.vertices.length).fill(255));
      this.skin = this.vertexArray(
        [[0, this.buffers.body, 3], [1, this.buffers.bodyNormal, 3], [2, skin, 3, gl.UNSIGNED_BYTE]],
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

  moveBody(vertices) {
    this.body.vertices = vertices;
    normalsOf(vertices, this.body.faces, this.body.normals);
    this.upload(this.buffers.body, vertices);
    this.upload(this.buffers.bodyNormal, this.body.normals);
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

  /** Pixels of the page that a centimetre takes at the middle of the garment. */
  pixelsPerCm() {
    const { distance, slope } = this.camera();
    return this.canvas.clientHeight / (2 * slope * distance);
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
    const common = { view: camera.view, eye: camera.eye, key, lit: [-1, -1], dimmed: theme.dimmed, shown: shownPanels() };
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
      width: 1.7 * ratio, lit: seam, accent: theme.accent, panels: lit, dimmed: theme.dimmed, opacity: 1, shown: shownPanels(),
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
    const { positions, corners, panelOf } = this.garment;
    let last = corners.length; // faces of outer garments come last
    while (last && panelOf[corners[last - 1]] >= shownPanels()) last -= 3;
    const cloth = nearestHit(eye, ray, positions, corners.subarray(0, last));
    const skin = this.skin && state.body && state.stage > 0.6 ? nearestHit(eye, ray, this.body.vertices, this.body.faces) : null;
    const depth = Math.min(cloth ? cloth.distance : Infinity, skin ? skin.distance : Infinity);
    const seam = this.seamAt(x, y, camera, width, height, depth);
    if (seam !== null) return { kind: "seam", number: seam };
    if (!cloth || cloth.distance > depth) return null;
    return { kind: "panel", number: panelOf[corners[3 * cloth.face]] };
  }

  seamAt(x, y, { eye, view }, width, height, depth) {
    const { ends, segments, segmentSeam, panelOf } = this.garment;
    const points = new Float32Array(4);
    let best = SEAM_REACH;
    let found = null;
    for (let s = 0; s < segmentSeam.length; s++) {
      if (segmentSeam[s] >= data.seams.length || panelOf[segments[2 * s]] >= shownPanels()) continue;
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
