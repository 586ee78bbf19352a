// The mesh of the garment at any stage: 0 panels laid flat, 1 placed round the body, 2 draped.

const SHEET_DISTANCE = 34; // cm from the wearer's axis to the sheet with the flat panels

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
    // Five times where panels are placed: they are creased beside their seams, in a zigzag of the mesh.
    for (let pass = stage < 1 ? 0 : stage < 1.5 ? 5 : 1; pass; pass--) smoothNormals(this.normals, this.corners, vertexOf, this.sums);
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
