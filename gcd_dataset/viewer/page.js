// The page of one garment: highlights in the drawing and in the picture, controls, start.

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const TURN = 0.0085; // rad per pixel
const TILT = [-1.45, 1.45]; // rad
const ZOOM = [0.08, 4];
const SCHEMES = ["", "light", "dark"];
const SHEET_ZOOM = 16; // largest magnification of the drawing
const LAST = 2; // the last stage, also of a garment that ends at an earlier one
const PIXELS_FOR_NUMBERS = 9; // pixels per cm from which seam numbers are legible

const state = { stage: 0, layers: data.layers.length, body: true, colours: "panels", lit: null, pinned: null, yaw: 0, pitch: 0.06, zoom: 1, pan: [0, 0, 0] };

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

const HOT = [214, 38, 41];

/** RGB bytes of each corner in a mode: panels, crossings, or one of the values of the cloth. */
function cornerColours(garment, mode) {
  const bytes = new Uint8Array(3 * garment.count);
  const neutral = themeColours().neutral.map((part) => Math.round(255 * part));
  const crossed = new Set(mode === "crossings" && garment.crossed ? garment.crossed : []);
  const scale = garment.values[mode];
  const last = scale && scale.colours.length / 3 - 1;
  for (let i = 0; i < garment.count; i++) {
    const vertex = garment.vertexOf[i];
    let colour = garment.panels[garment.panelOf[i]].colour;
    if (mode === "crossings") colour = crossed.has(vertex) ? HOT : neutral;
    if (scale) {
      const level = Math.round(last * clamp((scale.of[vertex] - scale.low) / (scale.high - scale.low), 0, 1));
      colour = scale.colours.subarray(3 * level, 3 * level + 3);
    }
    bytes.set(colour, 3 * i);
  }
  return bytes;
}

// ---------------------------------------------------------------------------------------------------------- highlights

let picture = null;
let pending = 0;

/** Camera, stage and colours: what stays from one garment to the next. */
function currentView() {
  const { yaw, pitch, zoom, pan, colours, body } = state;
  const stage = picture && state.stage === picture.garment.last ? LAST : state.stage;
  return { yaw, pitch, zoom, pan, stage, colours, body, scheme: document.documentElement.dataset.scheme || "" };
}

let quiet = true; // while the page starts, or follows another one

/** Tell the page around this one, if any, what has changed. */
function tell(name, detail) {
  if (!quiet) document.dispatchEvent(new CustomEvent(name, { detail }));
}

/** Do something without telling the page around. */
function quietly(action) {
  const before = quiet;
  quiet = true;
  try {
    action();
  } finally {
    quiet = before;
  }
}

/** Show the garment as another one is shown; unknown or missing values are left out. */
function follow(view) {
  quietly(() => {
    if (SCHEMES.includes(view.scheme) && view.scheme !== (document.documentElement.dataset.scheme || "")) setScheme(view.scheme);
    if (!picture) return;
    if (Number.isFinite(view.yaw)) state.yaw = view.yaw;
    if (Number.isFinite(view.pitch)) state.pitch = clamp(view.pitch, ...TILT);
    if (Number.isFinite(view.zoom)) state.zoom = clamp(view.zoom, ...ZOOM);
    if (Array.isArray(view.pan) && view.pan.length === 3 && view.pan.every(Number.isFinite)) state.pan = [...view.pan];
    if ($("body") && typeof view.body === "boolean") $("body").checked = state.body = view.body;
    if (Number.isFinite(view.stage) && clamp(view.stage, 0, picture.garment.last) !== state.stage) setStage(view.stage);
    const mode = [...document.querySelectorAll("input[name=colours]:enabled")].find((input) => input.value === view.colours);
    if (mode && view.colours !== state.colours) setColours(view.colours);
    redraw();
  });
}

/** The view that the address of the page asks for after its #; null without one. */
function askedView() {
  try {
    const view = JSON.parse(decodeURIComponent(location.hash.slice(1)));
    return view && typeof view === "object" ? view : null;
  } catch {
    return null;
  }
}

/** Draw again, after a change of the view. */
function changed() {
  tell("gcd-view", currentView());
  redraw();
}

function redraw() {
  if (!picture || pending) return;
  pending = requestAnimationFrame(() => {
    pending = 0;
    picture.draw();
    showScale($("view-scale"), picture.pixelsPerCm());
  });
}

/** The two panels that stay coloured: the lit one, or those of the lit seam; -1 where nothing is lit. */
function litPanels() {
  if (!state.lit) return [-1, -1];
  return state.lit.kind === "panel" ? [state.lit.number, state.lit.number] : data.seams[state.lit.number].panels;
}

/** The number of panels of the garments that are not taken off. */
function shownPanels() {
  return data.layers.length ? data.layers[state.layers - 1] : data.panels.length;
}

const same = (a, b) => (a && b ? a.kind === b.kind && a.number === b.number : a === b);

/** Light a panel or a seam in both views; null for none. */
function light(part) {
  part = part || state.pinned;
  if (same(part, state.lit)) return;
  state.lit = part;
  tell("gcd-lit", part);
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
  recolour(data.panels.map((panel) => panel.colour));
  svg.addEventListener("pointerleave", () => light(null));
  svg.addEventListener("pointermove", (event) => event.target === svg && light(null));
  svg.addEventListener("click", (event) => event.target === svg && state.pinned && pin(null));
  prepareSheet(svg);
}

/** Give the panels other colours, RGB bytes each, in both views. */
function recolour(colours) {
  document.querySelectorAll("#pattern [data-panel]").forEach((group, number) => {
    data.panels[number].colour = colours[number];
    group.firstElementChild.style.setProperty("--panel", `rgb(${colours[number]})`);
  });
  if (picture) quietly(() => setColours(state.colours));
}

/** Wheel and pinch zoom the drawing, dragging moves it, a double click shows all of it. */
function prepareSheet(svg) {
  const whole = svg.getAttribute("viewBox").split(" ").map(Number);
  let box = [...whole];
  const show = (next) => {
    box = next;
    svg.setAttribute("viewBox", box.join(" "));
    svg.classList.toggle("close", svg.getScreenCTM().a > PIXELS_FOR_NUMBERS);
    showScale($("pattern-scale"), svg.getScreenCTM().a);
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
  changed();
}

/** Show the first garments of an outfit, from the skin outwards. */
function setLayers(count) {
  state.layers = count;
  $("layers").value = count;
  document.querySelectorAll("[data-layer]").forEach((button) => {
    button.setAttribute("aria-pressed", String(Number(button.dataset.layer) === count));
  });
  document.body.dataset.layers = count;
  changed();
}

/** Show a frame of the motion of cloth and body. */
function setFrame(frame) {
  const { garment, body } = picture;
  const frames = Number($("motion").max) + 1;
  const of = (all, one) => one.map((_, i) => all[3 * (frames * Math.floor(i / 3) + frame) + (i % 3)]);
  garment.draped = of(garment.motion, garment.draped);
  if (body && body.motion) picture.moveBody(of(body.motion, body.vertices));
  $("motion").value = frame;
  document.body.dataset.frame = frame;
  setStage(garment.last);
}

let playing = 0;

/** Play the motion over and over, or stop it. */
function play() {
  const from = Number($("motion").value);
  const frames = Number($("motion").max) + 1;
  let begun = null;
  const step = (now) => {
    begun = begun ?? now;
    setFrame((from + Math.floor((now - begun) * data.mesh.fps / 1000)) % frames);
    playing = requestAnimationFrame(step);
  };
  if (playing) cancelAnimationFrame(playing);
  playing = playing ? 0 : requestAnimationFrame(step);
  $("play").setAttribute("aria-pressed", String(playing > 0));
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
  changed();
}

function resetCamera() {
  Object.assign(state, { yaw: 0, pitch: 0.06, zoom: 1, pan: [0, 0, 0] });
  changed();
}

function turn(dx, dy) {
  state.yaw -= dx;
  state.pitch = clamp(state.pitch + dy, ...TILT);
  changed();
}

function zoom(factor) {
  state.zoom = clamp(state.zoom * factor, ...ZOOM);
  changed();
}

function pan(dx, dy) {
  const { right, up } = picture.camera();
  const perPixel = 1 / picture.pixelsPerCm();
  state.pan = add(state.pan, add(scaled(right, -dx * perPixel), scaled(up, dy * perPixel)));
  changed();
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
  if ($("layers")) {
    $("layers").addEventListener("input", (event) => setLayers(Number(event.target.value)));
    document.querySelectorAll("[data-layer]").forEach((button) => {
      button.addEventListener("click", () => setLayers(Number(button.dataset.layer)));
    });
    setLayers(state.layers);
  }
  if ($("motion")) {
    $("motion").addEventListener("input", (event) => {
      if (playing) play();
      setFrame(Number(event.target.value));
    });
    $("play").addEventListener("click", play);
  }
  if ($("body")) {
    $("body").addEventListener("change", (event) => {
      state.body = event.target.checked;
      changed();
    });
  }
  $("reset").addEventListener("click", resetCamera);
}

const systemDark = matchMedia("(prefers-color-scheme: dark)");

/** Show a scheme: light, dark, or the empty text for that of the system. */
function setScheme(scheme) {
  if (scheme) document.documentElement.dataset.scheme = scheme;
  else delete document.documentElement.dataset.scheme;
  $("scheme").setAttribute("aria-pressed", String(scheme ? scheme === "dark" : systemDark.matches));
  if (picture) setColours(state.colours);
}

function prepareScheme() {
  $("scheme").addEventListener("click", () => {
    setScheme($("scheme").getAttribute("aria-pressed") === "true" ? "light" : "dark");
    changed();
  });
  systemDark.addEventListener("change", () => setScheme(document.documentElement.dataset.scheme || ""));
  setScheme(document.documentElement.dataset.scheme || "");
}

async function start() {
  document.documentElement.classList.toggle("framed", window.parent !== window);
  $("facts").open = matchMedia("(min-width: 1200px)").matches;
  addEventListener("beforeprint", () => ($("facts").open = true));
  preparePattern();
  $("parts").addEventListener("change", (event) => {
    const [kind, number] = event.target.value.split(":");
    state.pinned = null;
    pin(kind ? { kind, number: Number(number) } : null);
  });
  document.addEventListener("keydown", (event) => event.key === "Escape" && state.pinned && pin(null));
  const view = askedView();
  if (view && SCHEMES.includes(view.scheme)) document.documentElement.dataset.scheme = view.scheme;
  prepareScheme();
  window.gcdPage = {
    state, setStage, setFrame, follow, recolour,
    colours: () => data.panels.map((panel) => panel.colour),
    light: (part, silent) => (silent ? quietly(() => light(part)) : light(part)),
  };
  await startPicture();
  if (view) follow(view);
  quiet = false;
  if (picture) document.body.dataset.ready = "true";
  window.gcdPage.isReady = true;
  document.dispatchEvent(new Event("gcd-ready"));
}

/** Start the 3-D view, if the garment has a mesh. */
async function startPicture() {
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
  window.gcdPage.picture = picture;
  prepareCanvas(picture.canvas);
  prepareControls();
  setStage(picture.garment.last);
  setColours(data.colours);
  new ResizeObserver(redraw).observe(picture.canvas);
}

start();
