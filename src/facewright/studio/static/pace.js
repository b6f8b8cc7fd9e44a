// How finely to draw so that the hand is followed: coarser while frames take long, fine again when nothing moves.

/** From fine to coarse: share of the full resolution, and whether light comes from pictures of a sphere. */
const LEVELS = [
  { share: 1, quickly: false },
  { share: 1, quickly: true },
  { share: 0.7, quickly: true },
  { share: 0.5, quickly: true },
  { share: 0.35, quickly: true },
];
const SLOW_MS = 34; // between frames
const VERY_SLOW_MS = 120;
const CALM_MS = 600;
const TOO_LONG_MS = 250; // a still picture that takes longer is drawn quickly too

export class Pace {
  /** `apply(level)` draws by a level from now on. */
  constructor(apply) {
    this.apply = apply;
    this.moving = 0; // level while something moves
    this.now = 0;
    this.slow = 0;
    this.last = -Infinity;
    this.still = 0; // level of still pictures
    this.resting = true;
  }

  /** Whether a still picture is due. */
  due(now) {
    if (this.resting || now - this.last < CALM_MS || this.now <= this.still) return false;
    this.set(this.still);
    this.resting = true;
    return true;
  }

  /** Before a frame. */
  begin(now) {
    const since = now - this.last;
    if (since < CALM_MS) {
      this.slow = since > SLOW_MS ? this.slow + (since > VERY_SLOW_MS ? 2 : 1) : 0;
      if (this.slow >= 3 && this.moving < LEVELS.length - 1) {
        this.moving += since > VERY_SLOW_MS && this.moving < LEVELS.length - 2 ? 2 : 1;
        this.slow = 0;
      }
    }
    this.resting = false;
    this.set(this.moving);
  }

  /** After a frame. */
  end(now) {
    this.last = now;
  }

  /** Say how long the still picture took to its end. */
  took(milliseconds) {
    if (milliseconds > TOO_LONG_MS) this.still = 1;
  }

  set(level) {
    if (level === this.now) return;
    this.now = level;
    this.apply(LEVELS[level]);
  }
}
