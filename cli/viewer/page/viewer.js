// A session's page. Pictures come as they are rendered; what the user changes goes out as soon as the change before has been taken,
// all of it together: the newest state wins. Names are set as text, never as markup.
"use strict";

const PATIENCE_MS = 25000;  // with an answer; a picture may be waited for for 10 s
const AGAIN_MS = 1000;      // after one that did not come
const TURN = 3.5;           // radians over the picture's width
const WHEEL = 0.0012;       // of the depth's logarithm, a pixel of the wheel
const KEY_STEP = 0.02;      // of the picture's width
const EDGE = 0.015;         // of the picture, where lights beside it are shown
const MOST_MATERIALS = 2000;

const $ = (id) => document.getElementById(id);
const set = (node, text) => { if (node.textContent !== text) node.textContent = text; };

let scene = null;    // as it is by now, what is on its way out included
let first = null;    // the camera that the session began with
let chosen = 0;      // light
let said = 0;        // number of the last change that was taken

// Colours. Radiance and intensity are linear; people choose sRGB.

const toByte = (x) => Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * Math.pow(x, 1 / 2.4) - 0.055));
const toLinear = (byte) => (byte / 255 <= 0.04045 ? byte / 255 / 12.92 : Math.pow((byte / 255 + 0.055) / 1.055, 2.4));
const hexOf = (rgb) => "#" + rgb.map((x) => toByte(Math.max(0, Math.min(1, x))).toString(16).padStart(2, "0")).join("");
const rgbOf = (hex) => [1, 3, 5].map((at) => toLinear(parseInt(hex.slice(at, at + 2), 16)));
const strength = (rgb) => Math.max(...rgb);
const hue = (rgb) => (strength(rgb) > 0 ? scaled(rgb, 1 / strength(rgb)) : [1, 1, 1]);
const figure = (x) => (x === 0 ? "0" : x >= 1e5 || x < 1e-3 ? x.toExponential(1) : String(Number(x.toPrecision(3))));
const milliseconds = (s) => (s < 1 ? Math.round(1000 * s) + " ms" : s.toFixed(s < 10 ? 2 : 1) + " s");

// Changes on their way out.

let pending = {};    // by what they change: the newest
let sending = false;
let since = null;    // when the first of `pending` was made
const unseen = [];   // [number, when it was made] of changes that no picture has shown

function change(part, index, fields) {
  if (part === "camera") {
    pending.camera = {origin: scene.camera.origin, forward: scene.camera.forward, up: scene.camera.up};
  } else {
    const all = (pending[part] ??= new Map());
    all.set(index, {...all.get(index), ...fields});
  }
  since ??= performance.now();
  send();
}

function words() {
  const out = {};
  if (pending.camera) out.camera = pending.camera;
  if (pending.lights) out.lights = [...pending.lights].map(([light, fields]) => ({light, ...fields}));
  if (pending.objects) out.objects = [...pending.objects].map(([object, fields]) => ({object, ...fields}));
  if (pending.materials) out.materials = [...pending.materials].map(([material, fields]) => ({material, ...fields}));
  return out;
}

async function send() {
  if (sending || since === null) return;
  sending = true;
  const body = JSON.stringify(words()), made = since;
  pending = {};
  since = null;
  try {
    const answer = await fetch("change", {method: "POST", headers: {"Content-Type": "application/json"}, body,
                                          signal: AbortSignal.timeout(PATIENCE_MS)});
    const told = await answer.json();
    set($("refused"), told.refused || "");
    if (told.change) {
      said = told.change;
      unseen.push([told.change, made]);
    }
  } catch (error) {
    lost();
  }
  sending = false;
  send();
}

// What can be taken hold of: lights, and objects that may move. A marker's data say which.

const thing = (held) => scene[held.part][held.index];
const heldBy = (marker) => ({part: marker.dataset.part, index: Number(marker.dataset.index)});

const box = () => $("stage").getBoundingClientRect();

function drawMarkers() {
  for (const marker of document.querySelectorAll(".marker")) {
    const held = heldBy(marker);
    const place = project(scene.camera, thing(held).position);
    marker.hidden = place === null;
    if (place === null) continue;
    // What lies beside the picture is shown at its edge, from where it can be drawn in.
    const shown = place.map((x) => Math.max(EDGE, Math.min(1 - EDGE, x)));
    marker.style.left = 100 * shown[0] + "%";
    marker.style.top = 100 * shown[1] + "%";
    marker.classList.toggle("outside", shown.some((x, k) => x !== place[k]));
    if (held.part === "objects") continue;
    marker.style.setProperty("--light", hexOf(hue(thing(held).intensity)));
    marker.classList.toggle("chosen", held.index === chosen);
  }
}

function addMarker(part, index, kind, name) {
  const marker = document.createElement("button");
  marker.type = "button";
  marker.id = part.slice(0, -1) + "-" + index;  // "light-0", "object-0"
  marker.className = "marker " + kind;
  marker.dataset.part = part;
  marker.dataset.index = index;
  marker.setAttribute("aria-label", (part === "lights" ? "Light " + name + ", " + kind : "Object " + name) + ": drag, or move by the arrow keys");
  const label = document.createElement("span");
  label.textContent = name;
  marker.append(label);
  $("markers").append(marker);
}

function makeMarkers() {
  $("markers").replaceChildren();
  scene.lights.forEach((light, index) => {
    if (light.type !== "directional") addMarker("lights", index, light.type, index);  // such a light is nowhere
  });
  scene.objects.forEach((object, index) => addMarker("objects", index, "object", object.name));
}

function move(held, position) {
  if (!position.every(Number.isFinite)) return;
  thing(held).position = position;
  change(held.part, held.index, {position});
  drawMarkers();
  fillLight();
}

// The panel.

const fixed = (x) => x.toFixed(2);

function fillLight() {
  const light = scene.lights[chosen];
  if (!light) return;
  $("light").value = String(chosen);
  const strongest = strength(light.intensity);
  $("light-strength").value = strongest > 0 ? Math.log2(strongest / light.usual) : -10;
  set($("light-value"), figure(strongest) + (light.type === "directional" ? " W/m\u00b2" : " W/sr"));
  $("light-color").value = hexOf(hue(light.intensity));
  $("bring").disabled = light.type === "directional";
  set($("light-position"), light.type === "directional" ? "from far away"
      : light.position.map((x, k) => fixed(x + scene.origin[k])).join(", ") + " m");
}

function fillMaterial() {
  const material = scene.materials[Number($("material").value)];
  if (!material) return;
  $("material-color").value = hexOf(material.base_color);
  const strongest = strength(material.emission);
  for (const node of [$("material-strength"), $("material-value")]) node.hidden = strongest === 0 && !material.shone;
  document.querySelector("label[for=material-strength]").hidden = $("material-strength").hidden;
  $("material-strength").value = strongest > 0 ? Math.log2(strongest / material.usual) : -10;
  set($("material-value"), figure(strongest));
}

function fillChoices() {
  const options = (node, names) => {
    const old = node.value;
    node.replaceChildren(...names.map((name, at) => {
      const option = document.createElement("option");
      option.value = String(at);
      option.textContent = name;
      return option;
    }));
    if (old !== "" && Number(old) < names.length) node.value = old;
  };
  options($("light"), scene.lights.map((light, at) => at + ", " + light.type));
  options($("material"), scene.materials.slice(0, MOST_MATERIALS).map((material, at) => material.name || "material " + at));
  $("light-form").hidden = scene.lights.length === 0;
  $("no-lights").hidden = scene.lights.length > 0;
  $("bring").hidden = scene.lights.length === 0;
}

// The panel shows the light.
function choose(held) {
  if (held.part === "lights") chosen = held.index;
  fillLight();
  drawMarkers();
}

$("light").addEventListener("change", () => choose({part: "lights", index: Number($("light").value)}));
$("material").addEventListener("change", fillMaterial);

// A slider's left end is none at all.
const stops = (node) => (Number(node.value) <= -10 ? 0 : Math.pow(2, Number(node.value)));

function setLight(intensity) {
  scene.lights[chosen].intensity = intensity;
  change("lights", chosen, {intensity});
  drawMarkers();
}

$("light-strength").addEventListener("input", () => {
  const light = scene.lights[chosen];
  if (strength(light.intensity) > 0) light.hue = hue(light.intensity);
  setLight(scaled(light.hue || [1, 1, 1], light.usual * stops($("light-strength"))));
  set($("light-value"), figure(strength(light.intensity)) + (light.type === "directional" ? " W/m\u00b2" : " W/sr"));
});
$("light-color").addEventListener("input", () => {
  const light = scene.lights[chosen];
  light.hue = hue(rgbOf($("light-color").value));
  setLight(scaled(light.hue, strength(light.intensity)));
});
$("material-color").addEventListener("input", () => {
  const index = Number($("material").value), base_color = rgbOf($("material-color").value);
  scene.materials[index].base_color = base_color;
  change("materials", index, {base_color});
});
$("material-strength").addEventListener("input", () => {
  const index = Number($("material").value), material = scene.materials[index];
  if (strength(material.emission) > 0) material.hue = hue(material.emission);
  const emission = scaled(material.hue || [1, 1, 1], material.usual * stops($("material-strength")));
  material.emission = emission;
  material.shone = true;
  change("materials", index, {emission});
  set($("material-value"), figure(strength(emission)));
});
$("bring").addEventListener("click", () => move({part: "lights", index: chosen}, pivot()));
$("back").addEventListener("click", () => moveCamera(first));

// The mouse, a pen or a finger.

function moveCamera(camera) {
  if (![...camera.origin, ...camera.forward, ...camera.up].every(Number.isFinite)) return;
  scene.camera = {...scene.camera, origin: camera.origin, forward: camera.forward, up: camera.up, right: camera.right};
  change("camera");
  drawMarkers();
}

// What the camera turns about: ahead of it, as far as the scene's middle.
function pivot() {
  const depth = Math.max(depthOf(scene.camera, scene.centre), 0.1 * scene.radius);
  return add(scene.camera.origin, scene.camera.forward, depth);
}

const placeOf = (event) => {
  const {left, top, width, height} = box();
  return [(event.clientX - left) / width, (event.clientY - top) / height];
};

let drag = null;  // {held, offset}, or of the camera {last, about, shifts}

$("stage").addEventListener("pointerdown", (event) => {
  if (!scene || drag) return;
  const marker = event.target.closest(".marker"), place = placeOf(event);
  if (marker) {
    const held = heldBy(marker);
    choose(held);
    marker.focus();
    const outside = marker.classList.contains("outside");
    drag = {held, offset: outside ? [0, 0] : sub(project(scene.camera, thing(held).position), place)};
  } else {
    drag = {last: place, about: pivot(), shifts: event.button === 2 || event.button === 1 || event.shiftKey};
    $("stage").classList.add("turning");
  }
  $("stage").setPointerCapture(event.pointerId);
  event.preventDefault();
});

$("stage").addEventListener("pointermove", (event) => {
  if (!drag) return;
  const place = placeOf(event);
  if (drag.held) {
    const depth = depthOf(scene.camera, thing(drag.held).position);
    move(drag.held, unproject(scene.camera, add(place, drag.offset), depth));
    return;
  }
  const [right, down] = sub(place, drag.last);
  drag.last = place;
  if (drag.shifts) {
    const [across, upwards] = reach(scene.camera, depthOf(scene.camera, drag.about));
    moveCamera(shifted(scene.camera, -2 * right * across, 2 * down * upwards));
  } else {
    moveCamera(orbited(scene.camera, drag.about, -TURN * right, -TURN * down * box().height / box().width));
  }
});

for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
  $("stage").addEventListener(name, () => {
    drag = null;
    $("stage").classList.remove("turning");
  });
$("stage").addEventListener("contextmenu", (event) => event.preventDefault());

$("stage").addEventListener("wheel", (event) => {
  if (!scene) return;
  event.preventDefault();
  const pixels = event.deltaY * (event.deltaMode === 1 ? 30 : 1);
  const marker = event.target.closest(".marker");
  const held = drag?.held ?? (marker ? heldBy(marker) : null);
  if (held) {
    choose(held);
    move(held, deepened(scene.camera, thing(held).position, Math.exp(-WHEEL * pixels)));
  } else {
    const about = pivot();
    const factor = Math.exp(WHEEL * pixels);
    moveCamera({...scene.camera, origin: add(about, sub(scene.camera.origin, about), factor)});
  }
}, {passive: false});

$("markers").addEventListener("keydown", (event) => {
  const held = heldBy(event.target), position = thing(held).position;
  const steps = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
  const deeper = {PageUp: 1.05, PageDown: 1 / 1.05}[event.key];
  if (!steps && !deeper) return;
  event.preventDefault();
  choose(held);
  if (deeper) return move(held, deepened(scene.camera, position, deeper));
  const place = add(project(scene.camera, position), scaled(steps, KEY_STEP));
  move(held, unproject(scene.camera, place, depthOf(scene.camera, position)));
});

// Pictures.

let rgba = null;

function draw(words, bytes) {
  const canvas = $("picture");
  if (canvas.width !== words.width || canvas.height !== words.height || !rgba) {
    canvas.width = words.width;
    canvas.height = words.height;
    rgba = new ImageData(words.width, words.height);
    rgba.data.fill(255);
    fit();
  }
  const to = rgba.data;
  for (let from = 0, at = 0; from < bytes.length; from += 3, at += 4) {
    to[at] = bytes[from];
    to[at + 1] = bytes[from + 1];
    to[at + 2] = bytes[from + 2];
  }
  canvas.getContext("2d").putImageData(rgba, 0, 0);
  $("waiting").hidden = true;
}

// As large as the window takes, and the picture's shape.
function fit() {
  const most = 0.82 * window.innerHeight * $("picture").width / $("picture").height;
  $("stage").style.maxWidth = Math.round(most) + "px";
}
window.addEventListener("resize", fit);

let shownLatency = null;

function tell(words) {
  let oldest = null;
  while (unseen.length && unseen[0][0] <= words.shows) {
    const [, made] = unseen.shift();
    oldest ??= made;
  }
  if (oldest !== null) shownLatency = performance.now() - oldest;
  set($("rate"), words.frames_per_second > 0 ? words.frames_per_second.toFixed(1) : "\u2013");
  set($("latency"), shownLatency === null ? "\u2013" : milliseconds(shownLatency / 1000));
  if (words.latency_seconds > 0) set($("farm"), milliseconds(words.latency_seconds));
  const behind = words.links_behind;
  set($("links"), behind > 0 ? `${behind} ${behind === 1 ? "change" : "changes"}` : "none");
  set($("samples"), words.samples + (words.last ? ", the finest" : ""));
  set($("seconds"), milliseconds(words.seconds));
  set($("made"), words.made.join(", ") || "nothing");
  set($("reused"), words.reused.join(", ") || "nothing");
  if (words.refused) set($("refused"), words.refused);
}

// The connection.

let heard = null;

function alive() {
  heard = Date.now();
  document.body.className = "live";
  set($("live-words"), "live");
  $("trouble").hidden = true;
  set($("trouble"), "");
}

function lost() {
  document.body.className = "stale";
  set($("live-words"), "no answer");
  $("trouble").hidden = false;
  const since = heard ? " since " + new Date(heard).toLocaleTimeString([], {hour12: false}) : "";
  set($("trouble"), "The session has not answered" + since + ": gleaner session has ended, or cannot be reached.");
}

async function open() {
  const answer = await fetch("scene.json", {signal: AbortSignal.timeout(PATIENCE_MS)});
  if (!answer.ok) throw new Error("status " + answer.status);
  const told = await answer.json();
  for (const light of told.lights) light.usual = strength(light.intensity) || 1;
  for (const material of told.materials) {
    material.usual = strength(material.emission) || 1;
    material.shone = strength(material.emission) > 0;
  }
  if (scene) {  // what the sliders' middles are stays
    told.lights.forEach((light, at) => { light.usual = scene.lights[at]?.usual ?? light.usual; });
    told.materials.forEach((material, at) => { material.usual = scene.materials[at]?.usual ?? material.usual; });
  }
  said = told.change;
  scene = told;
  first ??= told.camera;
  set($("name"), told.name);
  document.title = told.name + " \u00b7 Gleaner session";
  fillChoices();
  makeMarkers();
  choose({part: "lights", index: Math.min(chosen, Math.max(0, scene.lights.length - 1))});
  fillMaterial();
}

async function watch() {
  let seen = 0;
  for (;;) {
    try {
      if (!scene) await open();
      const answer = await fetch("picture?after=" + seen, {signal: AbortSignal.timeout(PATIENCE_MS)});
      if (answer.status !== 200 && answer.status !== 204) throw new Error("status " + answer.status);
      alive();
      if (answer.status === 204) continue;
      const words = JSON.parse(answer.headers.get("Gleaner-Picture"));
      const bytes = new Uint8Array(await answer.arrayBuffer());
      seen = words.number;
      // Another page of this session has changed something.
      if (words.change > said && !sending && since === null && !drag) await open();
      draw(words, bytes);
      drawMarkers();
      tell(words);
    } catch (error) {
      console.warn(error);
      lost();
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }
}

watch();
