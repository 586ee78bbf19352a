"use strict";
// Decoding of the packed arrays, vectors, normals. Positions in cm, y up, the wearer faces +z.

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

/** Average normals with those of neighbours, across seams: else the triangles of coarse cloth show as saw teeth. */
function smoothNormals(normals, faces, vertexOf, sums) {
  sums.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    for (let k = 0; k < 3; k++) {
      const sum = normals[3 * faces[f] + k] + normals[3 * faces[f + 1] + k] + normals[3 * faces[f + 2] + k];
      for (let c = f; c < f + 3; c++) sums[3 * vertexOf[faces[c]] + k] += sum;
    }
  }
  for (let i = 0; i < vertexOf.length; i++) {
    const [x, y, z] = sums.subarray(3 * vertexOf[i], 3 * vertexOf[i] + 3);
    const length = Math.hypot(x, y, z) || 1;
    normals.set([x / length, y / length, z / length], 3 * i);
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
