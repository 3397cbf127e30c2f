/* The page of `echelon play`: overlay, keys, on-screen controls and director, around viser's picture.
 *
 * Plain JavaScript; its files, this one first, are put one after the other into a function of the page (front_page.py),
 * so that they see one another's names, and speak JSON with /ride (messages.py). Here is what they all know.
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
