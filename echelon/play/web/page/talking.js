// Talking to /ride: the connection, what is said on it, and what is shown of it.

function send(message) {
  if (socket === null || socket.readyState !== WebSocket.OPEN || socket.bufferedAmount > 16384) return false;
  socket.send(JSON.stringify(message));
  return true;
}

function yourName() {
  const name = (byId("name").value || "").trim().slice(0, 24).trim();
  return name || "Guest";
}

function findViewer() {
  const element = document.getElementById("echelon-viewer");
  const number = element === null ? NaN : Number.parseInt(element.dataset.viewer, 10);
  return Number.isInteger(number) && number >= 0 ? number : null;
}

function hello() {
  send({ kind: "hello", viewer, name: yourName() });
}

function connect() {
  if (viewer === null || socket !== null) return;
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ride`);
  socket = opened;
  opened.onopen = hello;
  opened.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.kind === "welcome") onWelcome(message);
    else if (message.kind === "state") onState(message);
    else if (message.kind === "pong") onPong(message);
  };
  opened.onclose = (event) => {
    if (socket !== opened) return;
    socket = null;
    letGoOfEverything();
    if (lostAt === null) lostAt = performance.now();
    lastReason = event.reason || lastReason;
    retryIn = event.code === 1008 || event.code === 1013 ? 5000 : clamp(retryIn * 1.5, 400, 3000);
    showConnection();
    setTimeout(connect, retryIn);
  };
}

function onWelcome(message) {
  const first = welcome === null || welcome.mode !== message.mode;
  welcome = message;
  lostAt = null;
  lastReason = "";
  retryIn = 400;
  document.title = `${message.title} · Echelon`;
  byId("title").textContent = message.title;
  const crowd = message.crowd || "characters";
  byId("crowd").textContent = `${message.agents} ${crowd} · seed ${message.seed}`;
  byId("frames").textContent = Math.max(0, message.frames - 1);
  byId("seek").max = Math.max(0, message.frames - 1);
  root().classList.toggle("replay", message.mode === "replay");
  byId("timeline").hidden = message.mode !== "replay";
  byId("pause").hidden = message.mode === "replay";
  byId("handlebars").hidden = !isRidden();
  for (const group of root().querySelectorAll(".live")) group.hidden = message.mode === "replay";
  if (first) setView(isRidden() ? "saddle" : "follow");
  else setView(view);
  look.sent = false;
  showPeople();
  ping();
  showConnection();
  mirror();
}

function onPong(message) {
  const latency = performance.now() - message.at;
  root().dataset.latency = latency.toFixed(1);
  byId("latency").textContent = latency < 50 ? "" : `· ${latency.toFixed(0)} ms`;
}

function ping() {
  pingSent = performance.now();
  send({ kind: "ping", at: pingSent });
}

function notify(text, milliseconds = 5000) {
  byId("notice").textContent = text;
  byId("notice").hidden = false;
  noticeUntil = performance.now() + milliseconds;
}

function showConnection() {
  const connected = socket !== null && welcome !== null && lostAt === null;
  root().dataset.connected = connected;
  if (connected) {
    if (noticeIsOfConnection) noticeUntil = 0;
    noticeIsOfConnection = false;
    return;
  }
  byId("pace").className = "row idle";
  byId("pace-text").textContent = "Not connected";
  byId("latency").textContent = "";
  if (lostAt === null) return;
  noticeIsOfConnection = true;
  if (lastReason.includes("has stopped") || performance.now() - lostAt > GONE_AFTER) {
    notify("Echelon has stopped. This page comes back by itself when it is started again.", Infinity);
  } else if (lastReason) {
    notify(`This page was disconnected: ${lastReason}. Trying again…`, Infinity);
  } else {
    notify("The connection was lost. Trying again…", Infinity);
  }
}
