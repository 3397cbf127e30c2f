/* The page of `echelon play`: overlay, keys, on-screen controls and director, around viser's picture.
 *
 * Plain JavaScript in one file; it is put into the head of viser's client and speaks JSON with /ride (messages.py).
 *
 * Ids, stable, for tests and for styling:
 *   #echelon                 everything of ours; mirrors the state in data-* attributes, all of them text:
 *                            data-connected, -mode, -you, -viewer, -frame, -time, -paused, -rate, -real-time, -slow,
 *                            -ended, -speed [m/s], -gear, -place, -in-corral, -people, -riding (this page holds the
 *                            handlebars), -rider (number of who does, or empty), -view, -pedal, -brake, -steer, -lean
 *                            (what was last sent), -latency [ms] (there and back), -states (how many were received)
 *   about        #echelon-about #echelon-title #echelon-crowd #echelon-pace #echelon-pace-text #echelon-latency
 *   how it goes  #echelon-score #echelon-in-corral #echelon-agents #echelon-time #echelon-fallen
 *                #echelon-place #echelon-of #echelon-gap #echelon-gradient #echelon-distance #echelon-length
 *                #echelon-lap #echelon-race-time #echelon-track #echelon-note #echelon-paused #echelon-notice
 *   people       #echelon-people #echelon-people-list (li[data-person], .riding) #echelon-name #echelon-take
 *                #echelon-leave #echelon-pass-row #echelon-pass-to #echelon-pass #echelon-take-big #echelon-handlebars
 *   tools        #echelon-pause #echelon-director-open #echelon-help-open
 *   director     #echelon-director #echelon-view-saddle -follow -free, #echelon-slow-1 -2 -4 -10,
 *                #echelon-restart-open #echelon-save #echelon-bare
 *   restart      #echelon-restart (dialog) #echelon-seed #echelon-seed-other #echelon-number #echelon-restart-yes
 *                #echelon-restart-no
 *   help         #echelon-help (dialog) #echelon-help-close
 *   dashboard    #echelon-dash #echelon-speed #echelon-gear #echelon-gears #echelon-cadence #echelon-power
 *                #echelon-slope #echelon-steering #echelon-steer-is #echelon-steer-wish #echelon-lean
 *   controls     #echelon-pad-left #echelon-pad-right #echelon-pad-pedal #echelon-pad-brake #echelon-pad-gear-up
 *                #echelon-pad-gear-down #echelon-pad-ahead (.pressed while held, by finger or key)
 *   replay       #echelon-timeline #echelon-play #echelon-seek #echelon-frame #echelon-frames #echelon-clock
 *                #echelon-rate
 */
(() => {
  "use strict";

  // ---- what we know ------------------------------------------------------------------------------------------------
  const TICK = 20; // ms between two looks at what is held
  const SEND_EVERY = 33; // ms between two ride messages while the steering moves
  const REPEAT_EVERY = 200; // ms between two ride messages while nothing changes
  const STEER_IN = 2.4; // of full lock a second, towards the side
  const STEER_BACK = 5.0; // towards the middle
  const LOOK_PER_PIXEL = 0.0045; // rad
  const GONE_AFTER = 6000; // ms without a connection after which Echelon has stopped
  const SPELLED = { 1: "1", 0.5: "½", 0.25: "¼", 0.1: "1⁄10" };

  let socket = null;
  let welcome = null;
  let state = null;
  let viewer = null; // viser's number for this page
  let lostAt = null;
  let lastReason = "";
  let retryIn = 400;
  let states = 0;
  let view = null;
  let look = { yaw: 0, pitch: 0, sent: true, at: 0 };
  let lean = false;
  let seekHeldUntil = 0;
  let noticeUntil = 0; // performance.now() until which the notice stays
  let noticeIsOfConnection = false;
  let pingSent = 0;

  const held = new Set(); // actions held by keys
  const fingers = new Map(); // pointer id -> action
  const sent = { pedal: 0, brake: 0, steer: 0, lean: false, at: 0 };
  let steer = 0;
  let lastTick = performance.now();

  const byId = (id) => document.getElementById(`echelon-${id}`);
  const root = () => document.getElementById("echelon");
  const isLive = () => welcome !== null && welcome.mode !== "replay";
  const people = () => (state && state.people) || [];
  const rider = () => people().find((one) => one.riding) || null;
  const isRidden = () => isLive() && welcome.mode !== "watch"; // whether the world has a bicycle at all
  const amRiding = () => isLive() && rider() !== null && rider().id === welcome.you;
  const mayDirect = () => welcome !== null && (rider() === null || rider().id === welcome.you);
  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

  function remember(key, value) {
    try {
      if (value === undefined) return localStorage.getItem(`echelon-${key}`);
      localStorage.setItem(`echelon-${key}`, value);
    } catch {
      return null; // a private window without storage: the name is asked for anew
    }
    return value;
  }

  // ---- the page's body ---------------------------------------------------------------------------------------------
  const arrow = (turn) => `<svg viewBox="0 0 24 24" aria-hidden="true"><path transform="rotate(${turn} 12 12)" d="M12 4 20 16H4z"/></svg>`;
  const fact = (id, label, unit = "", extra = "") =>
    `<div class="fact" id="echelon-${id}-box"><b ${extra}><span id="echelon-${id}">–</span>${unit ? `<small>${unit}</small>` : ""}</b><span class="label">${label}</span></div>`;
  const pad = (id, action, label, inside, key, extra = "") =>
    `<button type="button" class="pad ${extra}" id="echelon-pad-${id}" data-action="${action}" aria-label="${label}" tabindex="-1">${inside}<kbd aria-hidden="true">${key}</kbd></button>`;

  const BODY = `
    <section class="panel" id="echelon-about" aria-label="What is played">
      <div id="echelon-title">Echelon</div>
      <div class="soft" id="echelon-crowd"></div>
      <div class="row idle" id="echelon-pace" role="status"><span id="echelon-pace-text">Connecting…</span><span class="soft" id="echelon-latency"></span></div>
    </section>

    <div id="echelon-top">
      <section class="panel" id="echelon-score" aria-label="How it goes" hidden>
        <div class="facts" id="echelon-herd" hidden>
          <div class="fact"><b class="large"><span id="echelon-in-corral">0</span><small>/ <span id="echelon-agents">0</span></small></b><span class="label">in the corral</span></div>
          ${fact("time", "time", "", 'class="large"')}
          <div class="fact" id="echelon-fallen-box" hidden><b class="large" id="echelon-fallen">0</b><span class="label">fallen</span></div>
        </div>
        <div class="facts" id="echelon-race" hidden>
          <div class="fact"><b class="large"><span id="echelon-place">–</span><small>/ <span id="echelon-of">–</span></small></b><span class="label">place</span></div>
          ${fact("gap", "gap ahead", "m")}
          ${fact("gradient", "gradient", "%")}
          <div class="fact"><b><span id="echelon-distance">–</span><small>/ <span id="echelon-length">–</span> km</small></b><span class="label">distance</span></div>
          <div class="fact" id="echelon-lap-box" hidden><b id="echelon-lap">1</b><span class="label">lap</span></div>
          ${fact("race-time", "time")}
        </div>
        <div class="track" role="progressbar" aria-label="Done" aria-valuemin="0" aria-valuemax="100"><i id="echelon-track"></i></div>
      </section>
      <div class="panel" id="echelon-paused" role="status" hidden>Paused</div>
      <div class="panel" id="echelon-note" role="status" hidden></div>
      <div class="panel" id="echelon-notice" role="alert" hidden></div>
    </div>

    <div id="echelon-side">
      <div id="echelon-tools">
        <button type="button" id="echelon-pause" aria-pressed="false">Pause</button>
        <button type="button" id="echelon-director-open" aria-expanded="false" aria-controls="echelon-director">Director</button>
        <button type="button" id="echelon-help-open" aria-label="Help: keys and controls">?</button>
      </div>
      <section class="panel" id="echelon-people" aria-label="Who is here">
        <ul id="echelon-people-list" aria-label="People"></ul>
        <div id="echelon-handlebars">
          <button type="button" class="grow" id="echelon-take" style="width:100%">Take the handlebars</button>
          <button type="button" class="grow" id="echelon-leave" style="width:100%" hidden>Let go</button>
          <div class="row" id="echelon-pass-row" hidden>
            <select id="echelon-pass-to" aria-label="Pass the handlebars to"></select>
            <button type="button" id="echelon-pass">Pass</button>
          </div>
        </div>
      </section>
      <section class="panel" id="echelon-director" aria-label="Director" hidden>
        <div class="group"><span class="label">View</span>
          <div class="choices" role="group" aria-label="View">
            <button type="button" id="echelon-view-saddle" data-view="saddle">Saddle</button><button type="button" id="echelon-view-follow" data-view="follow">Follow</button><button type="button" id="echelon-view-free" data-view="free">Free</button>
          </div></div>
        <div class="group live"><span class="label">Slow motion</span>
          <div class="choices" role="group" aria-label="Slow motion">
            ${[1, 2, 4, 10].map((part) => `<button type="button" id="echelon-slow-${part}" data-slow="${1 / part}" aria-label="${part === 1 ? "full speed" : `1/${part} of full speed`}">${SPELLED[1 / part]}</button>`).join("")}
          </div></div>
        <div class="group two live">
          <button type="button" id="echelon-restart-open">Restart…</button>
          <button type="button" id="echelon-save">Save take</button>
        </div>
        <div class="group"><label class="label" for="echelon-name">Your name</label>
          <input type="text" id="echelon-name" maxlength="24" autocomplete="off" spellcheck="false"></div>
        <div class="group"><button type="button" id="echelon-bare" style="width:100%">Only the picture</button></div>
      </section>
    </div>

    <div id="echelon-bottom">
      <button type="button" class="main" id="echelon-take-big" hidden>Take the handlebars</button>
      <section class="panel" id="echelon-dash" aria-label="Bicycle" hidden>
        <div class="dials">
          <div id="echelon-speed-box"><span id="echelon-speed">0.0</span><span class="label">km/h</span></div>
          <div class="fact"><b><span id="echelon-gear">–</span><small>/ <span id="echelon-gears">–</span></small></b><span class="label">gear</span></div>
          ${fact("cadence", "rpm")}
          ${fact("power", "watts")}
          <div class="fact" id="echelon-slope-box"><b><span id="echelon-slope">–</span></b><span class="label">slope %</span></div>
        </div>
        <div id="echelon-steering" role="img" aria-label="Steering"><i id="echelon-steer-wish"></i><i id="echelon-steer-is"></i></div>
        <div id="echelon-lean" hidden>Steering by leaning</div>
      </section>
    </div>

    <div class="pads" id="echelon-pads-left" hidden>
      ${pad("left", "left", "Steer left", arrow(-90), "A")}${pad("right", "right", "Steer right", arrow(90), "D")}
    </div>
    <div class="pads" id="echelon-pads-right" hidden>
      ${pad("gear-up", "gear-up", "Gear up", "+", "E", "small")}
      ${pad("brake", "brake", "Brake", "Brake", "S", "tall")}${pad("pedal", "pedal", "Pedal", "Pedal", "W", "tall")}
      ${pad("gear-down", "gear-down", "Gear down", "−", "Q", "small")}
    </div>

    <section class="panel" id="echelon-timeline" aria-label="Timeline" hidden>
      <button type="button" id="echelon-play" style="min-width:74px">Play</button>
      <div class="fact"><b id="echelon-clock">0:00.0</b><span class="label">time</span></div>
      <input type="range" id="echelon-seek" min="0" max="0" value="0" step="1" aria-label="Frame">
      <div class="fact"><b><span id="echelon-frame">0</span><small>/ <span id="echelon-frames">0</span></small></b><span class="label">frame</span></div>
      <select id="echelon-rate" aria-label="Speed of the replay">
        ${[-2, -1, 0.1, 0.25, 0.5, 1, 2, 4, 8].map((rate) => `<option value="${rate}"${rate === 1 ? " selected" : ""}>${rate < 0 ? `−${-rate}` : SPELLED[rate] || rate} ×</option>`).join("")}
      </select>
    </section>

    <button type="button" id="echelon-bare-hint" aria-label="Show the overlay" hidden>Overlay</button>

    <dialog id="echelon-restart" aria-labelledby="echelon-restart-title">
      <h2 id="echelon-restart-title">Restart?</h2>
      <p class="soft">The world begins anew. The take so far is kept.</p>
      <div class="fields">
        <div><label class="label" for="echelon-seed">Seed</label><input type="number" id="echelon-seed" min="0" max="2147483647" step="1"></div>
        <div><label class="label" for="echelon-number">Number of characters</label><input type="number" id="echelon-number" min="1" max="100000" step="1"></div>
      </div>
      <div class="row ends">
        <button type="button" id="echelon-seed-other" style="margin-right:auto">Another seed</button>
        <button type="button" id="echelon-restart-no">Go on</button>
        <button type="button" class="main" id="echelon-restart-yes">Restart</button>
      </div>
    </dialog>

    <dialog id="echelon-help" aria-labelledby="echelon-help-title">
      <h2 id="echelon-help-title">Keys</h2>
      <div class="keys">
        <span><kbd>W</kbd><kbd>↑</kbd></span><span>pedal</span>
        <span><kbd>S</kbd><kbd>↓</kbd><kbd>Space</kbd></span><span>brake</span>
        <span><kbd>A</kbd><kbd>D</kbd><kbd>←</kbd><kbd>→</kbd></span><span>steer</span>
        <span><kbd>Q</kbd><kbd>E</kbd></span><span>gear down, up</span>
        <span><kbd>L</kbd></span><span>steer by leaning, or by the bars</span>
        <span><kbd>T</kbd></span><span>take the handlebars, let go</span>
        <span><kbd>V</kbd></span><span>saddle, follow, free view</span>
        <span><kbd>C</kbd></span><span>look straight ahead</span>
        <span><kbd>P</kbd></span><span>pause</span>
        <span><kbd>R</kbd></span><span>restart (asks)</span>
        <span><kbd>O</kbd></span><span>only the picture</span>
        <span><kbd>H</kbd></span><span>this help</span>
      </div>
      <p class="soft">In the saddle, drag the picture to look around while you ride; a double click looks ahead again. In the
        free view drag to turn, scroll to come closer; while you do not ride, the riding keys fly the camera.</p>
      <p class="soft">In a replay <kbd>Space</kbd> plays and stops, <kbd>←</kbd> and <kbd>→</kbd> go frame by frame
        (with <kbd>Shift</kbd> by the second), <kbd>Home</kbd> and <kbd>End</kbd> to either end.</p>
      <div class="row ends"><button type="button" class="main" id="echelon-help-close">Close</button></div>
    </dialog>`;

  // ---- talking to /ride --------------------------------------------------------------------------------------------
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

  // ---- showing what is -------------------------------------------------------------------------------------------
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

  // ---- riding ----------------------------------------------------------------------------------------------------
  const KEYS = {
    KeyW: "pedal", ArrowUp: "pedal",
    KeyS: "brake", ArrowDown: "brake", Space: "brake",
    KeyA: "left", ArrowLeft: "left", KeyD: "right", ArrowRight: "right",
    KeyQ: "gear-down", KeyE: "gear-up",
  };
  const heldKeys = new Map(); // key code -> action
  const isHeld = (action) => held.has(action);

  function countHeld() {
    held.clear();
    for (const action of heldKeys.values()) held.add(action);
    for (const action of fingers.values()) held.add(action);
    for (const button of root().querySelectorAll("[data-action]")) {
      const pressed = held.has(button.dataset.action);
      button.classList.toggle("pressed", pressed);
      button.setAttribute("aria-pressed", String(pressed));
    }
  }

  function press(action) {
    if (action === "gear-up") send({ kind: "gear", step: 1 });
    else if (action === "gear-down") send({ kind: "gear", step: -1 });
    countHeld();
    tick();
  }

  function letGoOfEverything() {
    heldKeys.clear();
    fingers.clear();
    steer = 0;
    if (root() === null) return;
    countHeld();
    if (amRiding()) sendRide(performance.now());
  }

  function onHandlebars() {
    letGoOfEverything();
    const riding = amRiding();
    byId("pads-left").hidden = !riding;
    byId("pads-right").hidden = !riding;
    showPeople();
    if (riding && view === "free") setView("saddle");
  }

  function sendRide(now) {
    const ride = { kind: "ride", pedal: isHeld("pedal") ? 1 : 0, brake: isHeld("brake") ? 1 : 0, steer: Math.round(steer * 1000) / 1000, lean };
    if (!send(ride)) return;
    Object.assign(sent, ride, { at: now });
    const data = root().dataset;
    data.pedal = ride.pedal;
    data.brake = ride.brake;
    data.steer = ride.steer;
    data.lean = lean;
  }

  /** Moves the steering towards what is held and says so: at once when hands or feet change, else now and then. */
  function tick() {
    const now = performance.now();
    const step = clamp((now - lastTick) / 1000, 0, 0.1);
    lastTick = now;
    if (!amRiding()) {
      steer = 0;
    } else {
      const wanted = (isHeld("left") ? 1 : 0) - (isHeld("right") ? 1 : 0);
      const back = wanted === 0 || wanted * steer < 0;
      const most = Math.max(step, TICK / 2000) * (back ? STEER_BACK : STEER_IN);
      const aim = wanted * steer < 0 ? 0 : wanted;
      steer += clamp(aim - steer, -most, most);
      const feet = isHeld("pedal") !== (sent.pedal > 0) || isHeld("brake") !== (sent.brake > 0) || lean !== sent.lean;
      const begun = steer !== sent.steer && (sent.steer === 0 || steer === 0);
      const moved = steer.toFixed(3) !== sent.steer.toFixed(3) && now - sent.at >= SEND_EVERY;
      if (feet || begun || moved || now - sent.at >= REPEAT_EVERY) sendRide(now);
      byId("steer-wish").style.left = `${50 - steer * 48}%`;
      byId("lean").hidden = !lean;
    }
    if (!look.sent && now - look.at >= SEND_EVERY) sendLook(now);
  }

  // ---- looking ---------------------------------------------------------------------------------------------------
  const VIEWS = ["saddle", "follow", "free"];

  function setView(wanted) {
    view = wanted;
    send({ kind: "view", view });
    if (view === "saddle") look.sent = false;
    for (const name of VIEWS) byId(`view-${name}`).setAttribute("aria-pressed", String(name === view));
    mirror();
  }

  function sendLook(now) {
    look.sent = send({ kind: "look", yaw: look.yaw, pitch: look.pitch });
    look.at = now;
  }

  function lookAhead() {
    look.yaw = look.pitch = 0;
    look.sent = false;
  }

  let drag = null; // of the picture: pointer, place, and how far it came
  let lastTap = 0;
  const isPicture = (event) => event.target instanceof HTMLCanvasElement && !root().contains(event.target);

  function onPicturePointer(event) {
    if (root() === null || view !== "saddle") return;
    if (event.type === "pointerdown" && isPicture(event) && drag === null) {
      drag = { id: event.pointerId, x: event.clientX, y: event.clientY, way: 0 };
      event.target.setPointerCapture(event.pointerId);
      if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
    } else if (drag !== null && event.pointerId === drag.id) {
      if (event.type === "pointermove") {
        const dx = event.clientX - drag.x;
        const dy = event.clientY - drag.y;
        drag.way += Math.abs(dx) + Math.abs(dy);
        drag.x = event.clientX;
        drag.y = event.clientY;
        // the picture is what is dragged: to the right, and we look to the left
        const turned = look.yaw + dx * LOOK_PER_PIXEL;
        look.yaw = clamp(Math.atan2(Math.sin(turned), Math.cos(turned)), -3.14159, 3.14159);
        look.pitch = clamp(look.pitch + dy * LOOK_PER_PIXEL, -1.5, 1.5);
        look.sent = false;
      } else if (event.type !== "pointerdown") {
        const now = performance.now();
        if (drag.way < 6 && event.type === "pointerup") {
          if (now - lastTap < 350) lookAhead();
          lastTap = now;
        }
        drag = null;
      }
    } else if (!isPicture(event)) {
      return;
    }
    event.stopImmediatePropagation();
    if (event.cancelable && event.type === "wheel") event.preventDefault();
  }

  for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) window.addEventListener(type, onPicturePointer, true);
  for (const type of ["wheel", "contextmenu", "dblclick"]) {
    window.addEventListener(type, (event) => {
      if (root() === null || view !== "saddle" || !isPicture(event)) return;
      event.stopImmediatePropagation();
      event.preventDefault();
    }, { capture: true, passive: false });
  }

  // ---- keys ------------------------------------------------------------------------------------------------------
  // On the window and in the capture phase, so that they come before viser's listeners on the document.
  const isTyping = (target) => target instanceof HTMLElement && (target.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName));
  const isOurButton = (target) => target instanceof HTMLButtonElement && root().contains(target);
  const openDialog = () => root().querySelector("dialog[open]");

  function consume(event) {
    event.preventDefault();
    event.stopImmediatePropagation();
  }

  function onKeyDown(event) {
    if (root() === null) return;
    if ((event.ctrlKey || event.metaKey) && event.code === "KeyK") return consume(event); // viser's palette
    if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return;
    if (isTyping(event.target) && !(event.target.id === "echelon-seek")) {
      if (event.code === "Escape") event.target.blur();
      if (event.code === "Enter" && event.target.closest("#echelon-restart")) restart();
      else if (event.code === "Enter") event.target.blur();
      return event.stopImmediatePropagation();
    }
    if (openDialog() !== null) {
      if (event.code === "KeyH" && openDialog().id === "echelon-help") openDialog().close();
      return event.stopImmediatePropagation();
    }
    // a button reached with Tab is pressed with its own keys
    if (isOurButton(event.target) && event.target.matches(":focus-visible") && ["Space", "Enter"].includes(event.code)) return event.stopImmediatePropagation();
    if (welcome === null) return;
    if (welcome.mode === "replay" && onReplayKey(event)) return consume(event);
    const action = KEYS[event.code];
    if (action !== undefined) {
      if (!amRiding()) {
        if (view !== "free" || event.code === "Space") consume(event);
        return; // in the free view viser flies its camera by these keys
      }
      consume(event);
      if (event.repeat || heldKeys.has(event.code)) return;
      heldKeys.set(event.code, action);
      return press(action);
    }
    if (event.repeat || event.shiftKey) return;
    const command = COMMANDS[event.code];
    if (command !== undefined) {
      consume(event);
      command();
    }
  }

  function onKeyUp(event) {
    if (!heldKeys.delete(event.code)) return;
    consume(event);
    countHeld();
    tick();
  }

  const COMMANDS = {
    KeyL: () => {
      if (!amRiding()) return;
      lean = !lean;
      tick();
    },
    KeyT: () => isRidden() && send({ kind: amRiding() ? "leave" : "take" }),
    KeyV: () => setView(VIEWS[(VIEWS.indexOf(view) + 1) % VIEWS.length]),
    KeyC: lookAhead,
    KeyP: () => isLive() && togglePause(),
    KeyR: () => isLive() && openRestart(),
    KeyH: () => byId("help").showModal(),
    KeyO: toggleBare,
    Escape: () => root().classList.contains("bare") && toggleBare(),
  };

  function onReplayKey(event) {
    if (!state) return false;
    const frames = welcome.frames;
    const by = event.shiftKey ? welcome.frame_rate || 30 : 1;
    if (event.code === "Space" || event.code === "KeyP") {
      if (!event.repeat) send({ kind: "play", playing: Boolean(state.paused) });
    } else if (event.code === "ArrowLeft") stepTo(currentFrame() - by);
    else if (event.code === "ArrowRight") stepTo(currentFrame() + by);
    else if (event.code === "Home") stepTo(0);
    else if (event.code === "End") stepTo(frames - 1);
    else return false;
    return true;
  }

  // while the slider runs ahead of what was last shown, steps are counted from it
  const currentFrame = () => (performance.now() < seekHeldUntil ? Number(byId("seek").value) : state.frame);
  let seekSentAt = 0;
  let seekLater = 0;

  function stepTo(frame) {
    if (!state.paused && performance.now() > seekHeldUntil) send({ kind: "play", playing: false });
    byId("seek").value = clamp(frame, 0, Math.max(0, welcome.frames - 1));
    onSeek();
  }

  function onSeek() {
    seekHeldUntil = performance.now() + 400;
    clearTimeout(seekLater);
    const now = performance.now();
    const go = () => {
      seekSentAt = performance.now();
      send({ kind: "seek", frame: Number(byId("seek").value) });
    };
    if (now - seekSentAt >= SEND_EVERY) go();
    else seekLater = setTimeout(go, SEND_EVERY);
  }

  window.addEventListener("keydown", onKeyDown, true);
  window.addEventListener("keyup", onKeyUp, true);
  window.addEventListener("blur", letGoOfEverything);
  document.addEventListener("visibilitychange", letGoOfEverything);
  window.addEventListener("pagehide", letGoOfEverything);

  // ---- directing -------------------------------------------------------------------------------------------------
  function togglePause() {
    if (!mayDirect()) return notify(`${rider().name} holds the handlebars and directs.`, 2500);
    send({ kind: "pause", paused: !(state && state.paused) });
  }

  function openRestart() {
    if (!mayDirect()) return notify(`${rider().name} holds the handlebars and directs.`, 2500);
    letGoOfEverything();
    byId("seed").value = welcome.seed;
    byId("number").value = welcome.agents;
    byId("restart").showModal();
    byId("restart-yes").focus();
  }

  function restart() {
    const whole = (id, low, high) => {
      const value = Number.parseInt(byId(id).value, 10);
      return Number.isInteger(value) && value >= low && value <= high ? value : null;
    };
    send({ kind: "restart", seed: whole("seed", 0, 2147483647), agents: whole("number", 1, 100000) });
    byId("restart").close();
  }

  function toggleBare() {
    const bare = root().classList.toggle("bare");
    byId("bare-hint").hidden = !bare;
  }

  // ---- putting it together ---------------------------------------------------------------------------------------
  function wire() {
    const click = (id, act) => byId(id).addEventListener("click", act);
    click("take", () => send({ kind: "take" }));
    click("take-big", () => send({ kind: "take" }));
    click("leave", () => send({ kind: "leave" }));
    click("pass", () => send({ kind: "pass", to: Number(byId("pass-to").value) }));
    click("pause", togglePause);
    click("director-open", () => {
      const panel = byId("director");
      panel.hidden = !panel.hidden;
      byId("director-open").setAttribute("aria-expanded", String(!panel.hidden));
    });
    click("help-open", () => byId("help").showModal());
    click("help-close", () => byId("help").close());
    click("bare", toggleBare);
    click("bare-hint", toggleBare);
    click("restart-open", openRestart);
    click("restart-yes", restart);
    click("restart-no", () => byId("restart").close());
    click("seed-other", () => {
      byId("seed").value = Math.floor(Math.random() * 1e6);
    });
    click("save", () => send({ kind: "save" }));
    click("play", () => send({ kind: "play", playing: Boolean(state && state.paused) }));
    byId("seek").addEventListener("input", onSeek);
    byId("rate").addEventListener("change", () => {
      send({ kind: "rate", rate: Number(byId("rate").value) });
      byId("rate").blur();
    });
    byId("name").value = remember("name") || "Guest";
    byId("name").addEventListener("change", () => {
      byId("name").value = yourName();
      remember("name", yourName());
      if (viewer !== null) hello();
    });
    for (const button of root().querySelectorAll("[data-view]")) button.addEventListener("click", () => setView(button.dataset.view));
    for (const button of root().querySelectorAll("[data-slow]")) {
      button.addEventListener("click", () => send({ kind: "slow", rate: Number(button.dataset.slow) }));
    }
    for (const button of root().querySelectorAll("[data-action]")) wirePad(button);
    // a click leaves the keys to riding; whoever came by Tab stays where they are
    root().addEventListener("pointerup", (event) => {
      const control = event.target instanceof Element ? event.target.closest("button") : null;
      if (control !== null) setTimeout(() => control.blur(), 0);
    });
  }

  function wirePad(button) {
    button.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      button.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, button.dataset.action);
      press(button.dataset.action);
    });
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
      button.addEventListener(type, (event) => {
        if (!fingers.delete(event.pointerId)) return;
        countHeld();
        tick();
      });
    }
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** Once in a while: viser's number for this page, the connection, and what is on show for a time only. */
  function lookAfter() {
    const found = findViewer();
    if (found !== null && found !== viewer) {
      viewer = found;
      if (socket === null) connect();
      else hello();
    }
    const now = performance.now();
    if (now > noticeUntil) byId("notice").hidden = true;
    if (lostAt !== null) showConnection();
    else if (now - pingSent > 2000) ping();
  }

  function begin() {
    const overlay = document.createElement("div");
    overlay.id = "echelon";
    overlay.dataset.connected = "false";
    overlay.innerHTML = BODY;
    document.body.append(overlay);
    const icon = document.querySelector('link[rel="icon"]');
    if (icon !== null) {
      const drawing = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" fill="#14191e"/><g fill="none" stroke="#f0b84a" stroke-width="3" stroke-linecap="round"><path d="M7 23 12 9M14 23 19 9M21 23 26 9"/></g></svg>';
      icon.href = `data:image/svg+xml,${encodeURIComponent(drawing)}`;
    }
    wire();
    mirror();
    if (document.createElement("canvas").getContext("webgl2") === null) notify("This browser cannot draw in 3D (WebGL 2 is missing or switched off).", Infinity);
    setInterval(tick, TICK);
    setInterval(lookAfter, 150);
  }

  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", begin);
  else begin();
})();
