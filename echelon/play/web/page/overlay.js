// The overlay's elements.

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
