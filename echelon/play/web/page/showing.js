// Showing what is: a state that was told, in the overlay and in its data-* attributes.

const known = (value) => typeof value === "number";
const round = (value, digits = 0) => (known(value) ? value.toFixed(digits).replace("-", "−") : "–");
function clock(seconds) {
  if (!known(seconds)) return "–";
  const tenths = Math.round(Math.abs(seconds) * 10);
  const minutes = Math.floor(tenths / 600);
  return `${seconds < 0 ? "−" : ""}${minutes}:${String(((tenths % 600) / 10).toFixed(1)).padStart(4, "0")}`;
}
function put(id, text) {
  const element = byId(id);
  if (element.textContent !== text) element.textContent = text;
}

function onState(message) {
  const peopleBefore = JSON.stringify(people());
  const wasRiding = amRiding();
  state = message;
  states += 1;
  if (JSON.stringify(people()) !== peopleBefore) showPeople();
  if (amRiding() !== wasRiding) onHandlebars();
  showPace();
  showScore();
  showDash();
  showTimeline();
  showDirector();
  mirror();
}

function showPace() {
  const slow = Boolean(state.slow);
  const pace = byId("pace");
  const idle = state.paused || state.ended;
  pace.className = `row${idle ? " idle" : slow ? " slow" : ""}`;
  const slowMotion = isLive() && known(state.rate) && state.rate < 1 ? `Slow motion ${SPELLED[state.rate] || round(state.rate, 2)}` : "";
  put("pace-text", state.ended ? "Ended" : state.waiting ? "Waiting" : state.paused ? "Paused" : slow ? `Slowed to ${round(state.real_time * 100)} %` : slowMotion || "Keeping up");
  byId("paused").hidden = !(state.paused && isLive()) || Boolean(state.waiting); // the note says what it waits for
  byId("note").hidden = !state.note;
  put("note", state.note || "");
}

function showScore() {
  const { herd, race } = state;
  byId("score").hidden = !herd && !race;
  byId("herd").hidden = !herd;
  byId("race").hidden = !race;
  let done = 0;
  if (herd) {
    put("in-corral", round(herd.in_corral));
    put("agents", round(herd.agents));
    put("time", clock(state.time));
    byId("fallen-box").hidden = !herd.fallen;
    put("fallen", round(herd.fallen));
    done = herd.agents ? herd.in_corral / herd.agents : 0;
  } else if (race) {
    put("place", round(race.place));
    put("of", round(race.of));
    put("gap", round(race.gap, race.gap < 100 ? 1 : 0));
    put("gradient", state.rider ? round(state.rider.gradient, 1) : "–");
    put("distance", known(race.distance) ? round(race.distance / 1000, 2) : "–");
    put("length", known(race.length) ? round(race.length / 1000, 1) : "–");
    byId("lap-box").hidden = !(race.laps > 1);
    put("lap", `${round(race.lap)} / ${round(race.laps)}`);
    put("race-time", clock(state.time));
    done = race.length ? race.distance / race.length : 0;
  }
  const track = byId("track");
  track.style.width = `${clamp(done * 100, 0, 100).toFixed(1)}%`;
  track.parentElement.setAttribute("aria-valuenow", String(Math.round(clamp(done * 100, 0, 100))));
}

function showDash() {
  const bicycle = state.rider;
  byId("dash").hidden = !bicycle;
  if (!bicycle) return;
  put("speed", known(bicycle.speed) ? round(Math.abs(bicycle.speed) * 3.6, 1) : "–");
  put("gear", round(bicycle.gear));
  put("gears", round(bicycle.gears));
  put("cadence", round(bicycle.cadence));
  put("power", round(bicycle.power));
  put("slope", round(bicycle.gradient, 1));
  byId("slope-box").hidden = Boolean(state.race) || !known(bicycle.gradient);
  const degrees = known(bicycle.steering) ? bicycle.steering : 0;
  byId("steer-is").style.left = `${50 - clamp(degrees / 20, -1, 1) * 48}%`;
  byId("steering").setAttribute("aria-label", `Steering ${Math.abs(degrees).toFixed(0)}° ${degrees > 0.5 ? "left" : degrees < -0.5 ? "right" : "ahead"}`);
}

function showTimeline() {
  if (isLive() || welcome === null) return;
  put("frame", round(state.frame));
  put("clock", clock(state.time));
  put("play", state.paused ? "Play" : "Pause");
  byId("play").setAttribute("aria-pressed", String(!state.paused));
  if (performance.now() > seekHeldUntil) byId("seek").value = state.frame;
  const rate = byId("rate");
  if (document.activeElement !== rate && [...rate.options].some((option) => Number(option.value) === state.rate)) rate.value = String(state.rate);
}

function showDirector() {
  const may = mayDirect();
  const why = may || !rider() ? "" : `${rider().name} holds the handlebars and directs`;
  const controls = ["pause", "restart-open", "save", "slow-1", "slow-2", "slow-4", "slow-10", "play", "seek", "rate"];
  for (const id of controls) {
    byId(id).disabled = !may;
    byId(id).title = why;
  }
  put("pause", state.paused && !state.waiting ? "Go on" : "Pause");
  byId("pause").setAttribute("aria-pressed", String(Boolean(state.paused && !state.waiting)));
  for (const button of root().querySelectorAll("[data-slow]")) {
    button.setAttribute("aria-pressed", String(Math.abs(Number(button.dataset.slow) - state.rate) < 1e-6));
  }
}

function showPeople() {
  const list = byId("people-list");
  list.replaceChildren(
    ...people().map((one) => {
      const item = document.createElement("li");
      const name = document.createElement("span");
      const what = document.createElement("span");
      item.dataset.person = one.id;
      item.className = one.riding ? "riding" : "";
      name.textContent = shownName(one);
      what.className = "what";
      what.textContent = one.riding ? "rides" : "watches";
      item.append(name, what);
      return item;
    }),
  );
  const others = people().filter((one) => welcome !== null && one.id !== welcome.you);
  const select = byId("pass-to");
  const chosen = select.value;
  select.replaceChildren(...others.map((one) => new Option(`to ${shownName(one)}`, String(one.id))));
  if (others.some((one) => String(one.id) === chosen)) select.value = chosen;
  byId("take").hidden = rider() !== null;
  byId("leave").hidden = !amRiding();
  byId("pass-row").hidden = !amRiding() || others.length === 0;
  byId("take-big").hidden = !isRidden() || rider() !== null;
}

function shownName(one) {
  const name = one.name === "Guest" ? `Guest ${one.id}` : one.name;
  return welcome !== null && one.id === welcome.you ? `${name} (you)` : name;
}

function mirror() {
  const data = root().dataset;
  data.mode = welcome ? welcome.mode : "";
  data.you = welcome ? welcome.you : "";
  data.viewer = viewer === null ? "" : viewer;
  data.view = view || "";
  data.lean = lean;
  data.riding = amRiding();
  data.rider = rider() ? rider().id : "";
  data.states = states;
  if (!state) return;
  data.frame = state.frame;
  data.time = state.time;
  data.paused = Boolean(state.paused);
  data.rate = state.rate;
  data.realTime = state.real_time;
  data.slow = Boolean(state.slow);
  data.ended = Boolean(state.ended);
  data.speed = state.rider ? state.rider.speed : "";
  data.gear = state.rider ? state.rider.gear : "";
  data.place = state.race ? state.race.place : "";
  data.inCorral = state.herd ? state.herd.in_corral : "";
  data.people = people().length;
}
