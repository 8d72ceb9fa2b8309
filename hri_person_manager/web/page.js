"use strict";
// Everything that comes from the robot is written with textContent: a name is never markup.

const $ = id => document.getElementById(id);
const MARGIN_M = 1.0, LEAST_VIEW_M = 4.0, RETRY_MS = 1000, KNOWN_MS = 3000, SAY_MS = 6000;
let known = new Map(), socket = null, view = null, timer = 0, pictureUrl = "";

function put(element, text) { if (element.textContent !== text) element.textContent = text; }
function shortId(id) { return id.replace(/^anonymous_person_/, ""); }
function shortened(text) { return text.length > 14 ? text.slice(0, 13) + "…" : text; }
function titleOf(person) { return person.name || shortId(person.id) + (person.anonymous ? " (not known)" : " (no name)"); }
function duration(seconds) {
  if (seconds < 60) return Math.floor(seconds) + " s";
  if (seconds < 3600) return Math.floor(seconds / 60) + " min";
  return Math.floor(seconds / 3600) + " h " + Math.floor(seconds % 3600 / 60) + " min";
}
function say(text) {
  put($("message"), text);
  $("message").hidden = false;
  clearTimeout(timer);
  timer = setTimeout(() => { $("message").hidden = true; }, SAY_MS);
}

// --- the stream ---------------------------------------------------------------------------------
function connect() {
  socket = new WebSocket((location.protocol === "https:" ? "wss://" : "ws://") + location.host + "/live");
  socket.binaryType = "blob";
  socket.onopen = () => { connection("connected", false); if (document.hidden) socket.send("pause"); refreshKnown(); };
  socket.onmessage = event => typeof event.data === "string" ? show(JSON.parse(event.data)) : showPicture(event.data);
  socket.onclose = event => {
    connection(event.reason || "the robot does not answer; trying again", true);
    setTimeout(connect, RETRY_MS);
  };
}
function connection(text, lost) {
  put($("connection"), text);
  $("connection").classList.toggle("lost", lost);
  document.querySelectorAll("section").forEach(section => section.classList.toggle("stale", lost));
}
function showPicture(blob) {
  const url = URL.createObjectURL(blob), old = pictureUrl, from = socket;
  pictureUrl = url;
  const done = () => {
    if (old) URL.revokeObjectURL(old);
    if (from.readyState === WebSocket.OPEN) from.send("shown");
  };
  $("picture").onload = () => { $("picture").dataset.shown ||= String(performance.now()); done(); };
  $("picture").onerror = done;
  $("picture").src = url;
  $("picture").hidden = false;
}
function show(state) {
  put($("no-picture"), state.camera || "waiting for a picture …");
  if (state.camera) $("picture").hidden = true;
  $("no-picture").hidden = !$("picture").hidden;
  showPeople(state.people);
  showMap(state);
}

// --- the list -----------------------------------------------------------------------------------
function facts(person, people) {
  const found = ["here " + duration(person.since)];
  if (!person.face) found.push(person.body ? "face not seen" : "not seen");
  if (person.engagement) found.push(person.engagement === "engaged" ? "engaged with the robot" : person.engagement);
  if (person.posture) found.push(person.posture);
  if (person.looks_at === "") found.push("looks at the robot");
  else if (person.looks_at) found.push("looks at " + titleOf(people.find(one => one.id === person.looks_at) || { id: person.looks_at, anonymous: true }));
  return found.join(" · ");
}
function item(list, id, names) {
  let element = [...list.children].find(child => child.dataset.id === id);
  if (element) return element;
  element = document.createElement("li");
  element.dataset.id = id;
  const title = document.createElement("div"), dot = document.createElement("span");
  dot.className = "dot";
  const name = document.createElement("span");
  name.className = "name";
  title.append(dot, name);
  const line = document.createElement("p"), words = document.createElement("span"), speaking = document.createElement("span");
  line.className = "facts";
  words.className = "words";
  speaking.className = "strong";
  line.append(words, speaking);
  const buttons = document.createElement("p");
  buttons.className = "buttons";
  for (const command of names) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.command = command;
    button.textContent = { name: "Rename", enrol: "Enrol", export: "Export", forget: "Forget" }[command];
    button.addEventListener("click", () => ask(command, id, name.textContent, element.dataset.name));
    buttons.append(button);
  }
  element.append(title, line, buttons);
  list.append(element);
  return element;
}
function prune(list, ids) {
  for (const child of [...list.children]) if (!ids.has(child.dataset.id)) child.remove();
}
function showPeople(people) {
  const list = $("people");
  prune(list, new Set(people.map(person => person.id)));
  $("nobody").hidden = people.length > 0;
  for (const person of [...people].sort((one, other) => other.since - one.since)) {
    const element = item(list, person.id, ["enrol", "name", "export", "forget"]), kept = known.get(person.id);
    put(element.querySelector(".name"), titleOf(person));
    element.querySelector(".dot").style.background = person.colour;
    element.dataset.name = person.name;
    element.title = person.id;
    put(element.querySelector(".words"), facts(person, people) + (kept && kept.enrolled ? " · has agreed to be recognised" : ""));
    put(element.querySelector(".strong"), person.speaking ? " · speaking" : "");
    for (const button of element.querySelectorAll("button")) {
      button.setAttribute("aria-label", button.textContent + " " + titleOf(person));
      button.hidden = button.dataset.command === "enrol" ? Boolean(kept && kept.enrolled) : person.anonymous;
      button.disabled = button.dataset.command === "enrol" && !person.face;
      button.title = button.disabled ? "the face has to be seen now" : "";
    }
  }
}
async function refreshKnown() {
  if (!document.hidden && socket && socket.readyState === WebSocket.OPEN) {
    const answer = await send({ command: "list" });
    if (answer.success) showKnown(answer.known);
  }
}
function showKnown(people) {
  known = new Map(people.map(person => [person.id, person]));
  const away = people.filter(person => !person.here), list = $("known");
  prune(list, new Set(away.map(person => person.id)));
  $("known-section").hidden = away.length === 0;
  put($("known-title"), "Known, not here (" + away.length + ")");
  for (const person of away) {
    const element = item(list, person.id, ["name", "export", "forget"]);
    put(element.querySelector(".name"), titleOf(person));
    element.dataset.name = person.name;
    element.title = person.id;
    put(element.querySelector(".words"), (person.last_seen > 0 ? "last seen " + new Date(1000 * person.last_seen).toLocaleString() : "")
      + (person.enrolled ? " · has agreed to be recognised" : ""));
    for (const button of element.querySelectorAll("button"))
      button.setAttribute("aria-label", button.textContent + " " + titleOf(person));
  }
}

// --- actions ------------------------------------------------------------------------------------
async function send(request) {
  try {
    const answer = await fetch("/people", { method: "POST", body: JSON.stringify(request),
      headers: { "Content-Type": "application/json", "X-Ros4hri": "1" } });
    return await answer.json();
  } catch (error) {
    return { success: false, message: "the robot does not answer" };
  }
}
function ask(command, id, title, name) {
  const dialog = $("ask"), texts = {
    name: ["Rename " + title, "An empty name takes the name away."],
    enrol: ["Enrol " + title, "The robot will recognise this person's face later on, and the voice where that is switched on (voice_identity). The face has to be seen now."],
    forget: ["Forget " + title + "?", "Everything that is known of this person is removed, for good."],
    export: ["Export " + title, "Everything that is known of this person, as a file (JSON)."] };
  put($("ask-title"), texts[command][0]);
  put($("ask-text"), texts[command][1]);
  put($("ask-error"), "");
  $("ask-name-row").hidden = command !== "name" && command !== "enrol";
  $("ask-consent-row").hidden = command !== "enrol";
  $("ask-name").value = name;
  $("ask-consent").checked = false;
  dialog.querySelector("form").onsubmit = async event => {
    event.preventDefault();
    $("ask-ok").disabled = true;
    const answer = await send({ command, id, name: $("ask-name").value, consent: $("ask-consent").checked });
    $("ask-ok").disabled = false;
    if (!answer.success) { put($("ask-error"), answer.message); return; }
    if (command === "export") download(id, answer.data);
    dialog.close();
    say(answer.message);
    refreshKnown();
  };
  dialog.showModal();
}
function download(id, data) {
  const link = document.createElement("a"), url = URL.createObjectURL(new Blob([JSON.stringify(data, null, 1)], { type: "application/json" }));
  link.href = url;
  link.download = id + ".json";
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), RETRY_MS);
}
async function showNotice() {
  put($("notice-text"), "asking the nodes …");
  $("notice").showModal();
  put($("notice-text"), (await send({ command: "privacy" })).message);
}

// --- the map: forward is up, left is left; metres -----------------------------------------------
function draw(name, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  if (text !== undefined) element.textContent = text;
  return element;
}
const at = place => [-place.y, -place.x];
function bounds(places) {
  const points = places.map(at);
  let [left, right] = [Math.min(...points.map(p => p[0])), Math.max(...points.map(p => p[0]))];
  let [top, bottom] = [Math.min(...points.map(p => p[1])), Math.max(...points.map(p => p[1]))];
  const size = $("map").getBoundingClientRect(), ratio = size.width && size.height ? size.width / size.height : 16 / 9;
  let height = Math.max(bottom - top + 2 * MARGIN_M, (right - left + 2 * MARGIN_M) / ratio, LEAST_VIEW_M);
  const wanted = { x: (left + right) / 2 - height * ratio / 2, y: (top + bottom) / 2 - height / 2, w: height * ratio, h: height };
  // The view grows at once and shrinks slowly, so that it does not tremble with every step.
  if (view && wanted.x >= view.x && wanted.y >= view.y && wanted.x + wanted.w <= view.x + view.w && wanted.y + wanted.h <= view.y + view.h)
    for (const key in wanted) wanted[key] = view[key] + 0.1 * (wanted[key] - view[key]);
  return view = wanted;
}
function showMap(state) {
  const map = $("map"), placed = state.people.filter(person => person.place);
  const places = placed.map(person => person.place).concat(state.robot ? [state.robot] : []);
  $("no-place").hidden = places.length > 0;
  map.replaceChildren();
  map.setAttribute("aria-label", placed.length + (placed.length === 1 ? " person" : " people") + " on the map, " + state.groups.length
    + (state.groups.length === 1 ? " group" : " groups"));
  if (!places.length) { view = null; return; }
  const box = bounds(places), letters = box.h / 22;
  map.setAttribute("viewBox", [box.x, box.y, box.w, box.h].join(" "));
  const step = box.h > 30 ? 10 : box.h > 12 ? 5 : 1;
  for (let x = Math.ceil(box.x / step) * step; x < box.x + box.w; x += step)
    map.append(draw("line", { class: "grid", x1: x, x2: x, y1: box.y, y2: box.y + box.h }));
  for (let y = Math.ceil(box.y / step) * step; y < box.y + box.h; y += step)
    map.append(draw("line", { class: "grid", x1: box.x, x2: box.x + box.w, y1: y, y2: y }));
  map.append(draw("text", { class: "scale", x: box.x + 3 * letters, y: box.y + box.h - 0.4 * letters, "font-size": 0.8 * letters },
    "grid " + step + " m" + (state.frame ? ", " + state.frame : "")));
  const where = new Map(placed.map(person => [person.id, person.place]));
  if (state.robot) where.set("", state.robot);
  for (const group of state.groups) drawGroup(map, group.filter(id => where.has(id)).map(id => at(where.get(id))));
  for (const person of placed) drawPerson(map, person, letters);
  for (const person of placed) {
    if (person.looks_at === null || !where.has(person.looks_at)) continue;
    const [x1, y1] = at(person.place), [x2, y2] = at(where.get(person.looks_at));
    map.append(draw("line", { class: "gaze", x1, y1, x2, y2 }));
  }
  if (state.robot) {
    const [x, y] = at(state.robot);
    map.append(draw("path", { class: "robot", d: "M0 -0.3 L0.2 0.25 L-0.2 0.25 Z", transform: turned(x, y, state.robot.heading) }));
  }
}
function turned(x, y, heading) { return `translate(${x} ${y}) rotate(${-heading * 180 / Math.PI})`; }
function drawPerson(map, person, letters) {
  const [x, y] = at(person.place), fill = person.colour, opacity = Math.max(0.25, person.confidence);
  if (person.place.ellipse) {
    const [major, minor, turn] = person.place.ellipse;
    map.append(draw("ellipse", { class: "ellipse", rx: minor, ry: major, fill, opacity, transform: turned(x, y, turn) }));
  }
  const body = draw("g", { transform: turned(x, y, person.place.heading), opacity });
  body.append(draw("path", { class: "body", d: "M0 -0.36 L0.11 -0.12 L-0.11 -0.12 Z", fill }), draw("circle", { class: "body", r: 0.17, fill }));
  map.append(body, draw("text", { x, y: y + 0.2 + letters, "font-size": letters },
    shortened(person.name || shortId(person.id)) + (person.speaking ? " (speaking)" : "")));
}
function drawGroup(map, points) {
  if (points.length < 2) return;
  const cx = points.reduce((sum, p) => sum + p[0], 0) / points.length, cy = points.reduce((sum, p) => sum + p[1], 0) / points.length;
  points.sort((a, b) => Math.atan2(a[1] - cy, a[0] - cx) - Math.atan2(b[1] - cy, b[0] - cx));
  map.append(draw("polygon", { class: "group", points: points.map(p => p.join(",")).join(" ") }));
}

$("privacy").addEventListener("click", showNotice);
$("notice-close").addEventListener("click", () => $("notice").close());
$("ask-cancel").addEventListener("click", () => $("ask").close());
document.addEventListener("visibilitychange", () => {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(document.hidden ? "pause" : "resume");
});
setInterval(refreshKnown, KNOWN_MS);
connect();
