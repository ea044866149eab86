// The page of the console: one WebSocket, messages in, facts on the page. What is said, and which
// colour it has, is decided by the console's process (swarm/console/facts.py, session.py).
"use strict";

const $ = (id) => document.getElementById(id);
const KEYS = { h: "hold", " ": "hold", r: "resume", b: "rewind", l: "land", x: "release",
  j: "rejoin", a: "abort" };
const STALE = 1500; // milliseconds without news after which the page says so
const AGAIN = 1000; // milliseconds until the next attempt to connect
const [WRONG_TOKEN, MANY_TOKENS, REPLACED] = [4001, 4002, 4003]; // codes of session.py

let socket = null, plan = null, state = null, people = null, me = null;
let heardAt = 0, ended = null, view = "flat", killNumber = null;
let steps = []; // of a check on the ground, which is no flight
let token = takenToken();

// The token comes with the address of the page, or from the last time in this window.
function takenToken() {
  const given = decodeURIComponent(location.hash.slice(1));
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token") || "";
}

function say(message) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  if (!token) return askToken("");
  const secure = location.protocol === "https:";
  socket = new WebSocket(`${secure ? "wss" : "ws"}://${location.host}/socket`);
  socket.onopen = () => say({ do: "join", token, key: sessionStorage.getItem("key") || "",
    name: localStorage.getItem("name") || "" });
  socket.onmessage = (event) => {
    heardAt = performance.now();
    const message = JSON.parse(event.data);
    HANDLERS[message.kind](message);
  };
  socket.onclose = (event) => {
    me = null;
    showPeople();
    if (event.code === WRONG_TOKEN || event.code === MANY_TOKENS) {
      if (event.code === WRONG_TOKEN) sessionStorage.removeItem("token");
      askToken(event.reason);
    } else if (event.code === REPLACED) {
      showLink(event.reason, true);
    } else if (ended === null) {
      showLink("connection lost, trying again", true);
      setTimeout(connect, AGAIN);
    }
  };
}

// Draws with the next picture of the screen; a page in the background draws nothing, at once.
function drawn(draw) {
  if (document.hidden) draw();
  else requestAnimationFrame(draw);
}

function askToken(reason) {
  $("login").hidden = false;
  $("console").hidden = true;
  $("refused").textContent = reason;
  showLink("not connected", true);
  $("token").focus();
}

$("login").addEventListener("submit", (event) => {
  event.preventDefault();
  token = $("token").value.trim();
  if (!token) return;
  sessionStorage.setItem("token", token);
  $("token").value = "";
  connect();
});

const HANDLERS = {
  joined(message) {
    me = message.number;
    sessionStorage.setItem("key", message.key);
    $("login").hidden = true;
    $("console").hidden = false;
    $("events").replaceChildren();
    if (document.activeElement !== $("name")) $("name").value = message.name;
    showLink("live", false);
  },
  plan(message) {
    plan = message;
    $("mission").textContent = plan.name;
    $("kind").textContent = plan.words + (plan.emulated ? "; emulated vehicles" : "");
    document.title = `${plan.name}: swarm console`;
    document.querySelector(".maps").hidden = plan.paths === null;
    $("console").classList.toggle("mapless", plan.paths === null);
    showPhases();
    makeButtons();
  },
  state(message) {
    state = message;
    drawn(() => {
      showState();
      if (socket && socket.readyState === WebSocket.OPEN) socket.send("drawn");
    });
  },
  event(message) {
    const list = $("events"), item = document.createElement("li");
    const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
    item.className = message.level;
    const time = document.createElement("time");
    time.textContent = clock(message.time);
    item.append(time, message.words);
    list.append(item);
    while (list.children.length > 500) list.firstChild.remove();
    if (atEnd) list.scrollTop = list.scrollHeight;
  },
  people(message) {
    people = message;
    showPeople();
  },
  checked(message) {
    const over = state !== null && !state.ground;
    document.querySelector(".checked").hidden = over || message.rows.length === 0;
    if (message.phases.length !== steps.length) {
      steps = message.phases;
      showPhases();
    }
    fill($("checked").tBodies[0], message.rows.length, 3, (cells, k) => {
      const row = message.rows[k];
      put(cells[0], { bad: "error", warn: "warning", idle: "" }[row.level], row.level);
      put(cells[1], row.check);
      put(cells[2], row.words, row.level);
    });
  },
  answer(message) {
    if (message.command === "kill") endKill();
    const words = message.words.startsWith(`${message.command}:`) ? message.words
      : `${message.command}: ${message.words}`;
    $("answer").textContent = words;
  },
  kill(message) {
    killNumber = message.number;
    $("number").textContent = message.number;
    $("again").textContent = message.again ? "That was not the number; nothing was stopped." : "";
    $("killing").hidden = false;
    $("digits").value = "";
    $("digits").focus();
  },
  ended(message) {
    ended = message.words;
    const what = steps.length ? "check" : "flight";
    put($("wait"), `The ${what} has ended. ${ended}`, `wait ${message.level}`);
    showLink(`the ${what} has ended`, false);
    endKill();
    showPeople();
  },
};

const phases = () => (steps.length ? steps : plan.phases);

function showPhases() {
  if (!plan) return;
  $("console").classList.toggle("check", steps.length > 0);
  $("phases").replaceChildren(...phases().map((phase) => {
    const item = document.createElement("li");
    item.textContent = phase.name;
    item.title = phase.name;
    return item;
  }));
}

function endKill() {
  killNumber = null;
  $("killing").hidden = true;
}

const clock = (seconds) => {
  const tenths = Math.round(Math.abs(seconds) * 10), sign = seconds < 0 && tenths ? "-" : "";
  return `${sign}${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
};
const minutes = (seconds) => {
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
};
const number = (value, digits, unit) =>
  (value === null ? "–" : `${value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1")}${unit}`);

// Texts are changed only where they differ: a reader's selection and a screen reader's place stay.
function put(element, text, kind) {
  if (element.textContent !== text) element.textContent = text;
  if (kind !== undefined && element.className !== kind) element.className = kind;
}

function showLink(text, lost) {
  put($("link"), text, lost ? "link lost" : "link");
  $("console").classList.toggle("stale", lost);
  showButtons();
}

function showState() {
  if (!plan) return;
  const checks = steps.length > 0;
  if (!state.ground) document.querySelector(".checked").hidden = true;
  put($("clock"), checks ? clock(state.time) : `${clock(state.mission)} of ${clock(plan.duration)}`);
  const speed = state.rate < 0 ? `rewinding × ${(-state.rate).toFixed(2)}`
    : state.rate > 0 && state.rate < 0.995 ? `clock × ${state.rate.toFixed(2)}` : "";
  const landing = state.landing === null ? "" : `all landed in ${minutes(state.landing)}`;
  put($("landing"), [landing, speed].filter(Boolean).join(", ") || state.phase);
  const now = phases().findIndex((phase) => phase.name === state.phase);
  [...$("phases").children].forEach((item, k) => {
    const phase = phases()[k];
    item.className = now < 0 ? "" : k < now ? "done" : k === now ? "current" : "";
    const share = (state.mission - phase.start) / Math.max(phase.end - phase.start, 1e-9);
    if (k === now) item.style.setProperty("--share", `${100 * clamp(share, 0, 1)}%`);
  });
  showWait();
  $("windows").replaceChildren(...state.windows.map((one) => {
    const item = document.createElement("span");
    item.className = one.level;
    item.textContent = one.words;
    return item;
  }));
  fill($("margins").tBodies[0], state.margins.length, 3, (cells, k) => {
    const one = state.margins[k];
    put(cells[0], one.between);
    put(cells[1], one.distance, one.level);
    put(cells[2], one.limit, "dim");
  });
  fill($("team").tBodies[0], state.rows.length, 9, (cells, k) => showRow(cells, state.rows[k]));
  showButtons();
  redraw();
}

function showWait() {
  if (ended !== null) return;
  const wait = state.wait;
  if (!wait) {
    const slowed = state.slowed_by && state.rate < 0.995
      ? `The clock runs slower: ${state.slowed_by}.` : "The clock runs.";
    return put($("wait"), state.rate > 0 ? slowed : "", "wait good");
  }
  const missing = wait.missing.length ? `; missing: ${wait.missing.join(", ")}` : "";
  const left = wait.left === null ? ""
    : wait.then === "left" ? `; ${wait.left.toFixed(0)} s left` : `; ${wait.then} in ${wait.left.toFixed(0)} s`;
  put($("wait"), `${wait.words}${missing}${left}`, "wait");
}

function showRow(cells, row) {
  const labels = ["", "", "mode", "height", "error", "battery", "position", "link", "grip"];
  const volts = row.voltage === null ? "" : `, ${row.voltage.toFixed(1)} V`;
  const allowed = row.error === null ? "" : row.allowed === null ? " m" : ` of ${row.allowed.toFixed(2)} m`;
  const link = row.age === null ? "never" : [
    `${row.age.toFixed(1)} s`,
    row.rate === null ? "" : `${row.rate.toFixed(0)}/s`,
    row.loss === null ? "" : `${(100 * row.loss).toFixed(1)} % lost`,
  ].filter(Boolean).join(", ");
  const texts = [String(row.number), row.why ? `${row.state}: ${row.why}` : row.state, row.mode || "–",
    number(row.height, 2, " m"), number(row.error, 2, "") + allowed,
    row.battery === null ? "–" : `${(100 * row.battery).toFixed(0)} %${volts}`, row.fix, link,
    row.gripped ? "holds cable" : "open"];
  texts.forEach((text, k) => {
    put(cells[k], text);
    if (labels[k]) cells[k].dataset.label = labels[k];
  });
  cells[1].className = `words ${row.level}`;
  cells[0].parentElement.className = row.level === "bad" ? "bad" : "";
}

// Rows are made once and stay at their places.
function fill(body, rows, columns, show) {
  while (body.rows.length > rows) body.deleteRow(-1);
  while (body.rows.length < rows) {
    const row = body.insertRow();
    for (let k = 0; k < columns; k++) row.insertCell();
  }
  for (let k = 0; k < rows; k++) show(body.rows[k].cells, k);
}

// Command

function makeButtons() {
  const keyOf = (command) => Object.keys(KEYS).find((key) => KEYS[key] === command) || "";
  $("buttons").replaceChildren(...[...plan.commands, "kill"].map((command) => {
    const button = document.createElement("button");
    button.className = command;
    button.dataset.command = command;
    button.disabled = true;
    const head = document.createElement("b"), what = document.createElement("small");
    const name = document.createElement("span");
    name.textContent = { interrupt: "end the flight", kill: "kill…" }[command] || command;
    head.append(name);
    const key = command === "kill" ? "k" : keyOf(command);
    if (key) {
      const shown = document.createElement("kbd");
      shown.textContent = key;
      head.append(shown);
    }
    button.append(head, what);
    button.addEventListener("click", () => ask(command));
    return button;
  }));
}

function ask(command) {
  $("answer").textContent = "";
  const more = command === "go" ? { seen: state.time } : {};
  say(command === "kill" ? { do: "kill" } : { do: "command", command, ...more });
}

const holding = () => people !== null && me !== null && people.holder === me;

function showButtons() {
  for (const button of $("buttons").children) {
    const command = button.dataset.command;
    if (command === "interrupt")
      put(button.querySelector("span"), steps.length ? "end the check" : "end the flight");
    const [possible, effect] = (state && state.commands[command]) || [false, ""];
    button.hidden = state !== null && !(command in state.commands);
    // who gives the go must see the present state
    const old = command === "go" && $("console").classList.contains("stale");
    button.disabled = !(holding() && possible && ended === null && !old);
    put(button.querySelector("small"), effect);
  }
}

function showPeople() {
  const there = people ? people.people : [];
  const named = (k) => there.find((one) => one.number === k);
  const holder = people && named(people.holder), asking = people && named(people.asking);
  const here = there.filter((one) => one.here).length;
  put($("holder"), !holder ? "No one has command."
    : holding() ? "You have command."
    : `${holder.words} has command${holder.here ? "" : ", and lost the connection"}.`);
  put($("watching"), me === null ? "" : `${here} ${here === 1 ? "browser" : "browsers"}.`);
  $("take").hidden = holding();
  $("take").disabled = me === null || ended !== null || (asking && asking.number === me);
  put($("take"), !holder || !holder.here ? "Take command"
    : asking && asking.number === me ? "Asked for command…" : "Ask for command");
  $("leave").hidden = !holding();
  $("asking").hidden = !(holding() && asking);
  if (holding() && asking)
    put($("asks"), `${asking.words} asks for command, and gets it in ${Math.ceil(people.left)} s without an answer.`);
  if (!holding()) endKill();
  showButtons();
}

$("take").addEventListener("click", () => say({ do: "take" }));
$("leave").addEventListener("click", () => say({ do: "leave" }));
$("give").addEventListener("click", () => say({ do: "hand over" }));
$("keep").addEventListener("click", () => say({ do: "keep" }));
$("cancel").addEventListener("click", () => say({ do: "cancel kill" }));
$("killing").addEventListener("submit", (event) => {
  event.preventDefault();
  if ($("digits").value.trim()) say({ do: "kill", number: $("digits").value.trim() });
});
$("name").addEventListener("change", () => {
  localStorage.setItem("name", $("name").value.trim());
  say({ do: "name", name: $("name").value.trim() });
  $("name").blur();
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  if (event.key === "Escape" && killNumber !== null) return say({ do: "cancel kill" });
  const place = document.activeElement;
  if (place instanceof HTMLInputElement || (event.key === " " && place !== document.body)) return;
  const command = event.key === "k" ? "kill" : KEYS[event.key];
  if (!command || !holding()) return;
  event.preventDefault();
  ask(command);
});

// Pictures

const drawSpace = spaceView($("scene"), $("labels"));

function redraw() {
  if (!plan || plan.paths === null || document.hidden) return;
  if (view === "space") return drawSpace(plan, state);
  drawAbove($("above"), plan, state);
  drawSide($("side"), plan, state);
}

for (const button of document.querySelectorAll(".views button")) {
  button.addEventListener("click", () => {
    view = button.dataset.view;
    for (const other of button.parentElement.children)
      other.setAttribute("aria-pressed", other === button);
    $("flat").hidden = view !== "flat";
    $("space").hidden = view !== "space";
    redraw();
  });
}
new ResizeObserver(redraw).observe($("console"));
darkScheme.addEventListener("change", redraw);

setInterval(() => {
  if (me === null || ended !== null) return;
  const silent = performance.now() - heardAt;
  if (silent > STALE) showLink(`nothing new for ${(silent / 1000).toFixed(0)} s`, true);
  else showLink("live", false);
  if (people && people.asking !== null && people.left > 0.5) {
    people.left -= 0.5;
    showPeople();
  }
}, 500);

connect();
