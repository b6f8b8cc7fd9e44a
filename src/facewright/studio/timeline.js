// Keyframes in time: click or drag to scrub, drag a diamond to move it.
const LABEL_EVERY_PX = 90;
const STEPS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 30, 60];
const EDGE = 18; // px left and right of the scale

export default {
  template: `
    <div ref="box" class="timeline" @pointerdown="down" @pointermove="drag" @pointerup="up" @pointercancel="up">
      <div v-for="tick in ticks" :key="tick.at" class="tick" :class="{ small: !tick.label }" :style="{ left: x(tick.at) + 'px' }">
        <span v-if="tick.label">{{ tick.label }}</span>
      </div>
      <div class="track"></div>
      <div v-if="times.length > 1" class="range" :style="{ left: x(times[0]) + 'px', width: x(times[times.length - 1]) - x(times[0]) + 'px' }"></div>
      <div v-for="(time, k) in times" :key="k" class="key" :class="{ chosen: k === selected }" :data-key="k"
           :style="{ left: x(moving && moving.index === k ? moving.time : time) + 'px' }"></div>
      <div class="playhead" :style="{ left: x(now) + 'px' }"><div class="flag">{{ now.toFixed(2) }}</div></div>
    </div>`,
  props: { times: Array, time: Number, span: Number, selected: Number },
  data: () => ({ width: 600, now: 0, moving: null, scrubbing: false }),
  computed: {
    ticks() {
      const room = this.width - 2 * EDGE;
      const step = STEPS.find((one) => (one / this.span) * room >= LABEL_EVERY_PX) ?? STEPS[STEPS.length - 1];
      const ticks = [];
      for (let k = 0; (k * step) / 5 <= this.span + 1e-9; k++) {
        const at = (k * step) / 5;
        ticks.push({ at, label: k % 5 ? "" : `${+at.toFixed(2)} s` });
      }
      return ticks;
    },
  },
  watch: {
    time(value) {
      if (!this.scrubbing) this.now = value;
    },
  },
  mounted() {
    this.now = this.time;
    this.watcher = new ResizeObserver(() => (this.width = this.$refs.box.clientWidth));
    this.watcher.observe(this.$refs.box);
    this.onTime = (event) => {
      if (!this.scrubbing) this.now = event.detail;
    };
    window.addEventListener("facewright-time", this.onTime);
  },
  unmounted() {
    this.watcher.disconnect();
    window.removeEventListener("facewright-time", this.onTime);
  },
  methods: {
    x(time) {
      return EDGE + (time / this.span) * (this.width - 2 * EDGE);
    },
    at(event) {
      const x = event.clientX - this.$refs.box.getBoundingClientRect().left - EDGE;
      return Math.min(this.span, Math.max(0, (x / (this.width - 2 * EDGE)) * this.span));
    },
    down(event) {
      this.$refs.box.setPointerCapture(event.pointerId);
      const key = event.target.dataset.key;
      if (key !== undefined) {
        this.moving = { index: +key, time: this.times[+key], from: event.clientX, moved: false };
        return;
      }
      this.scrubbing = true;
      this.drag(event);
    },
    drag(event) {
      if (this.moving) {
        this.moving.moved ||= Math.abs(event.clientX - this.moving.from) > 2;
        if (this.moving.moved) this.moving.time = this.at(event);
      } else if (this.scrubbing) {
        this.now = this.at(event);
        this.$emit("seek", this.now);
      }
    },
    up() {
      if (this.moving?.moved) this.$emit("move", { index: this.moving.index, time: this.moving.time });
      else if (this.moving) {
        this.now = this.times[this.moving.index];
        this.$emit("seek", this.now);
      }
      this.moving = null;
      this.scrubbing = false;
    },
  },
};
