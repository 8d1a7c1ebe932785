// A camera as the renderer has it: origin, right, up, forward (unit, right-handed), half_width and half_height (tangents of half the
// field of view; of an orthographic camera metres). Places on the picture are from 0 to 1, from its upper left corner.
"use strict";

const add = (a, b, factor = 1) => a.map((x, k) => x + factor * b[k]);
const sub = (a, b) => add(a, b, -1);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, factor) => a.map((x) => factor * x);
const length = (a) => Math.hypot(...a);
const unit = (a) => scaled(a, 1 / length(a));

const depthOf = (camera, point) => dot(sub(point, camera.origin), camera.forward);

// What a step of 1 to the right at this depth is on the picture's half width, in metres; and upwards.
function reach(camera, depth) {
  const factor = camera.orthographic ? 1 : depth;
  return [factor * camera.half_width, factor * camera.half_height];
}

// Where a point lies on the picture; null: behind the camera.
function project(camera, point) {
  const depth = depthOf(camera, point);
  if (!(depth > 0)) return null;
  const [across, upwards] = reach(camera, depth), from = sub(point, camera.origin);
  return [0.5 + dot(from, camera.right) / across / 2, 0.5 - dot(from, camera.up) / upwards / 2];
}

// The point at this depth that lies there on the picture.
function unproject(camera, place, depth) {
  const [across, upwards] = reach(camera, depth);
  const ahead = add(camera.origin, camera.forward, depth);
  return add(add(ahead, camera.right, (2 * place[0] - 1) * across), camera.up, (1 - 2 * place[1]) * upwards);
}

// The point seen at the same place of the picture, so many times as deep.
function deepened(camera, point, factor) {
  if (camera.orthographic) return add(point, camera.forward, (factor - 1) * depthOf(camera, point));
  return add(camera.origin, sub(point, camera.origin), factor);
}

function turned(vector, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(scaled(vector, c), cross(axis, vector), s), axis, dot(axis, vector) * (1 - c));
}

// About a pivot: by `around` about the world's vertical, and by `over` about the camera's own right, short of the poles.
function orbited(camera, pivot, around, over) {
  const vertical = [0, 1, 0];
  const height = Math.asin(Math.max(-1, Math.min(1, dot(camera.forward, vertical))));
  const limit = 1.55;
  const allowed = Math.max(-limit, Math.min(limit, height + over)) - height;
  const turn = (v) => turned(turned(v, camera.right, allowed), vertical, around);
  const forward = unit(turn(camera.forward)), up = unit(turn(camera.up));
  return {...camera, forward, up, right: unit(cross(forward, up)), origin: add(pivot, turn(sub(camera.origin, pivot)))};
}

const shifted = (camera, across, upwards) =>
    ({...camera, origin: add(add(camera.origin, camera.right, across), camera.up, upwards)});
