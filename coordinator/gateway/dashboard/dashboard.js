// The coordinator's page: asks for farm.json every second and shows it. Whatever people and workers choose themselves
// (names, messages) is set as text, never as markup.
"use strict";

const EVERY_MS = 1000;    // a look at the farm
const PATIENCE_MS = 8000; // with one answer
const PICTURE_MS = 2000;  // between two looks at a job's picture
const MOST_PICTURES = 6;

const $ = (id) => document.getElementById(id);

function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function make(tag, name, text) {
  const node = document.createElement(tag);
  if (name) node.className = name;
  if (text) node.textContent = text;
  return node;
}

// Words for figures.

function duration(seconds) {
  if (!(seconds >= 0)) return "";
  if (seconds < 1) return Math.round(1000 * seconds) + " ms";
  if (seconds < 10) return seconds.toFixed(1) + " s";
  if (seconds < 60) return Math.floor(seconds) + " s";
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return minutes + " min " + Math.floor(seconds % 60) + " s";
  const hours = Math.floor(minutes / 60);
  return hours < 48 ? hours + " h " + (minutes % 60) + " min" : Math.floor(hours / 24) + " days";
}

const timeLeft = (seconds) => (seconds < 1 ? "a moment" : "about " + duration(Math.round(seconds)).replace(".0", ""));

function count(value) {
  for (const [unit, name] of [[1e9, "G"], [1e6, "M"], [1e4, "k"]])
    if (value >= unit) return (value / (unit === 1e4 ? 1e3 : unit)).toPrecision(3) + " " + name;
  return value >= 10 ? String(Math.round(value)) : String(Number(value.toPrecision(2)));
}

const percent = (part) => Math.floor(100 * part) + " %";
const several = (n, one, many) => count(n) + " " + (n === 1 ? one : many);

function clock(unixSeconds) {
  const then = new Date(1000 * unixSeconds), today = new Date();
  const time = then.toLocaleTimeString([], {hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false});
  return then.toDateString() === today.toDateString() ? time : then.toLocaleDateString() + " " + time;
}

// Tables. A row stays the same element for as long as it is shown, so that nothing flickers or loses its selection.

class Table {
  constructor(id, empty) {
    this.body = $(id).querySelector("tbody");
    this.labels = [...$(id).querySelectorAll("th")].map((th) => th.textContent);
    this.empty = empty;
    this.rows = new Map();
    this.say(id);
  }
  // As cards on a phone (display: block) rows would be none to a screen reader.
  say(id) {
    $(id).setAttribute("role", "table");
    this.body.setAttribute("role", "rowgroup");
  }
  // The items in order, each with a key of its own; `fill(cells, item)` sets the cells' contents.
  show(items, key, fill) {
    const seen = new Set();
    let place = this.body.firstElementChild;
    for (const item of items) {
      const name = key(item);
      if (seen.has(name)) continue;
      seen.add(name);
      let row = this.rows.get(name);
      if (!row) this.rows.set(name, (row = this.make()));
      fill([...row.children].map((cell) => cell.firstElementChild), item);
      for (const cell of row.children) cell.classList.toggle("blank", cell.textContent === "");
      if (row === place) place = place.nextElementSibling;
      else this.body.insertBefore(row, place);
    }
    for (const [name, row] of this.rows)
      if (!seen.has(name)) {
        row.remove();
        this.rows.delete(name);
      }
    const note = this.body.querySelector("td.empty");
    if (seen.size > 0) {
      if (note) note.parentElement.remove();
    } else if (!note) {
      const cell = make("td", "empty", this.empty);
      cell.colSpan = this.labels.length;
      const row = make("tr");
      row.append(cell);
      this.body.append(row);
    }
  }
  make() {
    const row = make("tr");
    row.setAttribute("role", "row");
    for (const label of this.labels) {
      const cell = make("td");
      cell.dataset.label = label;
      cell.setAttribute("role", "cell");
      cell.append(make("div"));
      row.append(cell);
    }
    return row;
  }
}

// A cell's lines: [class, text], those without text left out.
function lines(cell, wanted) {
  const shown = wanted.filter(([, text]) => text);
  shown.forEach(([name, text], at) => {
    let line = cell.children[at];
    if (!line) cell.append((line = make("span")));
    if (line.className !== name) line.className = name;
    set(line, text);
  });
  while (cell.children.length > shown.length) cell.lastElementChild.remove();
}

function bar(cell, part, words) {
  let progress = cell.querySelector("progress");
  if (part === null) {
    if (progress) cell.replaceChildren();
    return;
  }
  if (!progress) {
    progress = make("progress");
    progress.max = 1;
    cell.replaceChildren(progress, make("span", "second"));
  }
  progress.value = part;
  progress.setAttribute("aria-label", words);
  set(cell.lastElementChild, words);
}

const jobs = new Table("jobs", "No jobs yet: gleaner submit makes one.");
const workers = new Table("workers", "No worker is connected: gleaner-worker --coordinator HOST:PORT adds one.");
const events = new Table("events", "Nothing has happened yet.");

function jobState(job) {
  return job.paused && (job.state === "queued" || job.state === "running") ? "paused" : job.state;
}

function errorWords(error) {
  return (100 * error.relative).toPrecision(2) + " % " + (error.denoised ? "expected" : "noise");
}

function fillJob(cells, job) {
  const [id, scene, method, state, frames, progress, time, left, error] = cells;
  for (const cell of [state, frames, time, left, error]) cell.className = "narrow";
  lines(id, [[job.name ? "" : "whole", job.name || job.job], ["second whole", job.name ? job.job : ""]]);
  lines(scene, [["", job.scene], ["second", job.owner ? "of " + job.owner : ""], ["why", job.state === "done" ? "" : job.message || ""],
                ["second", job.state === "done" ? job.message || "" : ""]]);
  lines(method, [["", job.method], ["second whole", job.size.join(" x ")]]);
  lines(state, [["state " + jobState(job), jobState(job)]]);
  lines(frames, [["", job.frames_done + " of " + job.frames], ["second", job.frames_failed ? job.frames_failed + " failed" : ""]]);
  bar(progress, job.state === "running" ? job.progress : null, percent(job.progress));
  lines(time, [["", duration(job.seconds)]]);
  lines(left, [["", job.state === "running" && job.seconds_left >= 0 ? timeLeft(job.seconds_left) : ""]]);
  lines(error, job.error ? [["", errorWords(job.error)], ["second", job.frames > 1 ? "frame " + job.error.frame : ""]] : []);
}

// Rates of the kind of its last batch; of the batch alone where the farm has no figure yet.
function lastBatch(worker) {
  const last = worker.last_batch;
  if (!last) return [];
  const rate = last.seconds > 0 ? last.items / last.seconds : 0;
  return [["", rate > 0 ? count(rate) + " items/s" : ""],
          ["second", last.kind + ", " + several(last.items, "item", "items") + " in " + duration(last.seconds)]];
}

function workerState(worker) {
  if (worker.gone) return worker.lost ? "lost" : "left";
  if (worker.aside) return "aside";
  if (worker.draining) return "draining";
  return worker.batch ? "works" : "idle";
}

const stateWords = {aside: "put aside", left: "has left"};

function fillWorker(cells, worker) {
  const [name, device, state, does, last, joined] = cells;
  for (const cell of [state, joined]) cell.className = "narrow";
  const word = workerState(worker);
  lines(name, [["", worker.worker]]);
  if (worker.gone) {
    lines(device, [["", worker.device]]);
    lines(state, [["state " + word, stateWords[word] || word], ["second", clock(worker.unix_seconds)]]);
    lines(does, [[worker.lost ? "why" : "second", worker.why || (worker.lost ? "its connection ended" : "")]]);
    lines(last, []);
    lines(joined, []);
    return;
  }
  lines(device, [["", worker.device], ["second", several(worker.threads, "thread", "threads") + ", " + worker.tracer]]);
  lines(state, [["state " + word, stateWords[word] || word],
                ["why", worker.silent_seconds > 10 ? "silent for " + duration(worker.silent_seconds) : ""]]);
  const batch = worker.batch;
  lines(does, [["", batch ? batch.stage + ", " + several(batch.items, "item", "items") : ""],
               ["second", batch ? (batch.job ? "job " + batch.job + ", frame " + batch.frame : "a session") +
                                      ", for " + duration(batch.seconds) : ""],
               ["why", worker.aside]]);
  lines(last, lastBatch(worker));
  lines(joined, [["", duration(worker.connected_seconds) + " ago"]]);
}

function fillEvent(cells, event) {
  const [when, what, why] = cells;
  when.className = "narrow";
  const who = {job: "job " + event.job, frame: "frame " + event.frame + " of job " + event.job, worker: "worker " + event.worker};
  const word = event.what === "aside" ? "put aside" : event.what;
  lines(when, [["", clock(event.unix_seconds)]]);
  lines(what, [["", event.kind === "missed" ? event.message : who[event.kind] + " " + word]]);
  lines(why, [[event.what === "failed" || event.what === "aside" ? "why" : "", event.message || ""]]);
}

// Pictures of the jobs that run.

class Picture {
  constructor(job) {
    this.job = job;
    this.figure = make("figure", "picture");
    this.frame = make("div", "frame");
    this.words = make("span", "", "No picture yet");
    this.title = make("div", "title");
    this.progress = make("progress");
    this.progress.max = 1;
    this.numbers = make("div");
    this.stages = make("div", "stages");
    const caption = make("figcaption");
    caption.append(this.title, this.progress, this.numbers, this.stages);
    this.frame.append(this.words);
    this.figure.append(this.frame, caption);
    this.ends = false;
    this.look();
  }
  fill(job) {
    set(this.title, (job.name || job.scene) + " \u00b7 " + job.method + " \u00b7 " + job.size.join(" x "));
    this.progress.value = job.progress;
    this.progress.setAttribute("aria-label", "Progress of job " + job.job);
    const left = job.seconds_left >= 0 ? ", " + timeLeft(job.seconds_left) + " left" : "";
    const frames = job.frames > 1 ? ", " + job.frames_done + " of " + job.frames + " frames" : "";
    set(this.numbers, percent(job.progress) + " after " + duration(job.seconds) + left + frames);
    const running = job.stages.filter((stage) => stage.items_done < stage.items);
    set(this.stages, running.map((stage) => stage.name + " " + percent(stage.items_done / stage.items) +
        (stage.items_per_second > 0 ? " at " + count(stage.items_per_second) + " items/s" : "")).join(", "));
    if (this.image) this.image.alt = "Job " + job.job + " as far as it is rendered: " + job.scene;
    this.alt = job.scene;
  }
  async look() {
    while (!this.ends) {
      if (!document.hidden) await this.fetch().catch(() => {});  // the farm's own answers say when it is away
      await new Promise((done) => setTimeout(done, PICTURE_MS));
    }
  }
  async fetch() {
    const answer = await fetch("picture.png?job=" + encodeURIComponent(this.job), {signal: AbortSignal.timeout(PATIENCE_MS)});
    if (answer.status !== 200 || this.ends) return;
    const url = URL.createObjectURL(await answer.blob());
    const image = new Image();
    image.alt = "Job " + this.job + " as far as it is rendered: " + (this.alt || "");
    image.src = url;
    await image.decode();
    this.frame.replaceChildren(image);
    this.image = image;
    if (this.url) URL.revokeObjectURL(this.url);
    this.url = url;
  }
  end() {
    this.ends = true;
    this.figure.remove();
    if (this.url) URL.revokeObjectURL(this.url);
  }
}

const pictures = new Map();

function showPictures(all) {
  const running = all.filter((job) => job.state === "running").slice(0, MOST_PICTURES);
  const wanted = new Set(running.map((job) => job.job));
  for (const [id, picture] of pictures)
    if (!wanted.has(id)) {
      picture.end();
      pictures.delete(id);
    }
  for (const job of running) {
    if (!pictures.has(job.job)) {
      const picture = new Picture(job.job);
      pictures.set(job.job, picture);
      $("pictures").append(picture.figure);
    }
    pictures.get(job.job).fill(job);
  }
  $("pictures-section").hidden = running.length === 0;
}

// All of it.

function showSums(farm) {
  const serving = farm.workers.connected - farm.workers.draining - farm.workers.aside;
  const notes = [];
  if (farm.workers.draining) notes.push(farm.workers.draining + " draining");
  if (farm.workers.aside) notes.push(farm.workers.aside + " put aside");
  set($("sum-workers"), String(serving));
  set($("note-workers"), notes.join(", "));
  set($("sum-running"), String(farm.jobs.running));
  set($("sum-queued"), String(farm.jobs.queued));
  const waits = [];
  if (farm.jobs.queued && !farm.workers.connected) waits.push("no worker is connected");
  if (farm.jobs.paused) waits.push(farm.jobs.paused + " paused");
  set($("note-queued"), waits.join(", "));
  set($("sum-frames"), String(farm.totals.frames_written));
  const failed = farm.totals.batches_failed + farm.totals.batches_expired;
  set($("sum-failed"), String(failed));
  set($("note-failed"), "of " + several(farm.totals.batches_accepted + failed, "batch", "batches") + (failed ? ", tried again" : ""));
  set($("version"), "Gleaner " + farm.version);
  document.title = farm.jobs.running ? several(farm.jobs.running, "job", "jobs") + " \u00b7 Gleaner" : "Gleaner";
}

function moreJobs(farm) {
  const known = {queued: farm.jobs.queued, running: farm.jobs.running, ended: farm.jobs.done + farm.jobs.failed + farm.jobs.cancelled};
  for (const job of farm.jobs.shown) --known[job.state in known ? job.state : "ended"];
  const words = [];
  if (known.running > 0) words.push(known.running + " more run");
  if (known.queued > 0) words.push(known.queued + " more wait");
  if (known.ended > 0) words.push(known.ended + " more have ended");
  return words.length ? words.join(", ") + ": gleaner list" : "";
}

function showWorkers(farm) {
  const gone = farm.workers.gone.map((worker) => ({...worker, gone: true}));
  const shown = farm.workers.shown;
  workers.show([...shown, ...gone],
               (worker) => (worker.gone ? "gone " + worker.unix_seconds + " " : "here ") + worker.worker, fillWorker);
  const more = farm.workers.connected - shown.length;
  set($("workers-more"), more > 0 ? more + " more are connected: gleaner workers" : "");
}

function show(farm) {
  showSums(farm);
  showPictures(farm.jobs.shown);
  jobs.show(farm.jobs.shown, (job) => job.job, fillJob);
  set($("jobs-more"), moreJobs(farm));
  showWorkers(farm);
  events.show(farm.events, (event) => String(event.number), fillEvent);
  set($("events-more"), farm.events.length ? "The last " + farm.events.length + ": gleaner events follows them" : "");
}

// The connection. `answered`: when the last answer came.
let answered = null;
let asking = false;

function say(alive, why) {
  document.body.className = alive ? "live" : "stale";
  set($("live-words"), alive ? "live, " + clock(answered / 1000) : "no answer");
  $("trouble").hidden = alive;
  if (alive) return set($("trouble"), "");
  set($("trouble"), answered === null ? "The coordinator does not answer (" + why + ")."
      : "The coordinator has not answered since " + clock(answered / 1000) + " (" + why + "). What is shown is from then.");
}

async function ask() {
  const answer = await fetch("farm.json", {signal: AbortSignal.timeout(PATIENCE_MS)});
  if (!answer.ok) throw new Error("status " + answer.status);
  return answer.json();
}

function whyOf(error) {
  if (error.name === "TimeoutError") return "it takes too long";
  return error instanceof TypeError ? "it cannot be reached" : String(error.message);
}

async function look() {
  if (asking || document.hidden) return;
  asking = true;
  try {
    const farm = await ask();
    answered = Date.now();
    say(true, "");
    asking = false;
    show(farm);
  } catch (error) {
    if (!asking) throw error;  // the page's own
    asking = false;
    say(false, whyOf(error));
  }
}

setInterval(look, EVERY_MS);
document.addEventListener("visibilitychange", look);
look();
