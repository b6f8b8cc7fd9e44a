// The view of a posed face: drag a point of it, turn it, see regions; one or two models side by side.
import { THREE } from "nicegui-scene";
import { Body, LOOKS } from "facewright-studio/body.js";
import { Pace } from "facewright-studio/pace.js";
import { Stage } from "facewright-studio/stage.js";
import { Stream, fetchShared } from "facewright-studio/stream.js";

const DRAG_STARTS_PX = 2;
const PUSH_MM = 0.02; // towards the viewer per unit of the wheel while dragging

export default {
  template: `
    <div class="pose-view">
      <canvas ref="canvas" tabindex="0" aria-label="Face: drag a point of it, drag beside it to turn"></canvas>
      <div ref="labels" class="pose-labels"></div>
      <div ref="hint" class="pose-hint"></div>
      <div ref="lost" class="pose-lost" style="display:none"><span>Connection lost, trying again…</span></div>
    </div>`,
  props: { address: String },

  async mounted() {
    this.kinds = ["region"];
    this.shown = ["region"];
    this.look = { regions: false, paint: true, handles: false, wires: false };
    this.dirty = true;
    this.frames = [];
    this.answers = []; // ms from a mouse event to its positions drawn
    this.held = null;
    this.hover = null;
    try {
      this.stage = new Stage(this.$refs.canvas);
      this.pace = new Pace(({ share, quickly }) => {
        this.stage.sharpen(share);
        this.lightFaces(quickly);
      });
      await this.load();
    } catch (error) {
      this.$refs.lost.style.display = "flex";
      this.$refs.lost.firstChild.textContent = `No 3D view: ${error.message}.`;
      return;
    }
    this.listen();
    this.watcher = new ResizeObserver(() => this.fit());
    this.watcher.observe(this.$el);
    this.fit();
    this.stage.frame(this.extent());
    this.stream = new Stream(`${this.address}/stream`, {
      pose: (views, time, sequence) => this.onPose(views, time, sequence),
      state: (state) => this.onState(state),
      open: () => this.onOpen(),
      closed: () => (this.$refs.lost.style.display = "flex"),
    });
    window.facewrightPose = this.probe();
    this.running = true;
    this.turn = () => {
      if (!this.running) return;
      requestAnimationFrame(this.turn);
      this.step();
    };
    requestAnimationFrame(this.turn);
  },

  unmounted() {
    this.running = false;
    this.watcher?.disconnect();
    this.stream?.close();
    window.removeEventListener("keydown", this.onKey);
    Object.values(this.bodies ?? {}).forEach((body) => body.dispose());
    this.stage?.dispose();
  },

  methods: {
    async load() {
      this.shared = await fetchShared(`${this.address}/body.bin`);
      this.kinds = this.shared.kinds;
      const old = this.bodies ?? {};
      Object.values(old).forEach((body) => {
        this.stage.scene.remove(body.group);
        body.dispose();
      });
      this.bodies = {};
      for (const kind of this.kinds) {
        const body = new Body(this.shared, this.stage.pixels);
        body.setLook(this.look);
        this.bodies[kind] = body;
        this.stage.scene.add(body.group);
      }
    },

    /** Fetch the face again: another character has been chosen. */
    async reload() {
      await this.load();
      this.stage.frame(this.extent());
      this.stream.ask("look again");
      this.dirty = true;
    },

    extent() {
      const { handles, positions } = this.shared;
      const box = new THREE.Box3();
      for (const v of handles) box.expandByPoint(new THREE.Vector3().fromArray(positions, 3 * v));
      const size = box.getSize(new THREE.Vector3());
      const centre = box.getCenter(new THREE.Vector3());
      centre.z = box.max.z - 0.75 * size.z;
      return { centre, width: size.x, height: size.y };
    },

    fit() {
      const { clientWidth, clientHeight } = this.$el;
      this.stage.resize(clientWidth, clientHeight, this.shown.length);
      this.$refs.labels.replaceChildren(
        ...this.shown.map((kind) => {
          const label = document.createElement("div");
          label.textContent = this.shown.length > 1 ? { region: "Region-based", holistic: "Holistic" }[kind] : "";
          return label;
        }),
      );
      this.dirty = true;
    },

    // From Python

    show(kinds) {
      this.shown = kinds.filter((kind) => this.kinds.includes(kind));
      this.fit();
    },

    setLook(changes) {
      Object.assign(this.look, changes);
      for (const kind of this.kinds) {
        const own = { ...changes };
        if (kind !== "region" && "regions" in own) own.regions = false; // it has none
        this.bodies[kind].setLook(own);
      }
      this.dirty = true;
    },

    lookFrom(yaw, pitch) {
      this.stage.look(yaw, pitch);
      this.dirty = true;
    },

    // From the session

    onOpen() {
      this.$refs.lost.style.display = "none";
      this.held = null;
    },

    onPose(views, time, sequence) {
      const fits = (kind, k) => views[k] && views[k].length === this.bodies[kind].positions.length;
      if (!this.kinds.every(fits)) return; // of another character, which is being fetched
      this.kinds.forEach((kind, k) => this.bodies[kind].place(views[k]));
      this.arrived = sequence;
      this.dirty = true;
      window.dispatchEvent(new CustomEvent("facewright-time", { detail: time }));
    },

    onState(state) {
      for (const kind of this.kinds) {
        this.bodies[kind].pins = state.pins[kind] ?? [];
        this.bodies[kind].mark();
      }
      this.dirty = true;
    },

    // The mouse

    listen() {
      const canvas = this.$refs.canvas;
      canvas.addEventListener("pointerdown", (event) => this.onDown(event), { capture: true });
      canvas.addEventListener("pointermove", (event) => this.onMove(event));
      canvas.addEventListener("pointerup", (event) => this.onUp(event));
      canvas.addEventListener("pointercancel", () => this.cancel());
      canvas.addEventListener("pointerleave", () => this.held || this.point(null));
      canvas.addEventListener("wheel", (event) => this.onWheel(event), { capture: true, passive: false });
      canvas.addEventListener("contextmenu", (event) => event.preventDefault());
      this.stage.controls.addEventListener("change", () => (this.dirty = true));
      this.onKey = (event) => this.onKeyDown(event);
      window.addEventListener("keydown", this.onKey);
    },

    pick(event) {
      const box = this.$refs.canvas.getBoundingClientRect();
      const ray = this.stage.ray(event.clientX - box.left, event.clientY - box.top);
      const kind = this.shown[ray.column];
      const found = this.bodies[kind].pick(ray);
      return found && { ...found, kind, ray };
    },

    onDown(event) {
      const found = event.button === 0 && !event.altKey ? this.pick(event) : null;
      if (!found || found.handle < 0) return;
      event.stopImmediatePropagation(); // the camera stays
      this.$refs.canvas.focus({ preventScroll: true });
      if (event.shiftKey || event.ctrlKey || event.metaKey) {
        this.togglePin(found.handle, found.kind);
        return;
      }
      this.$refs.canvas.setPointerCapture(event.pointerId);
      const start = new THREE.Vector3(...this.bodies[found.kind].handlePosition(found.handle));
      const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(
        this.stage.camera.getWorldDirection(new THREE.Vector3()).negate(), start,
      );
      const grip = this.onPlane(event, plane, found.kind) ?? start.clone();
      this.held = { ...found, plane, offset: start.clone().sub(grip), from: [event.clientX, event.clientY], moved: false };
      this.point(found);
    },

    onPlane(event, plane, kind) {
      const box = this.$refs.canvas.getBoundingClientRect();
      const wide = this.stage.width / this.stage.columns;
      const left = this.shown.indexOf(kind) * wide;
      const x = Math.min(left + wide - 1e-3, Math.max(left, event.clientX - box.left)); // the view it began in
      const { origin, direction } = this.stage.ray(x, event.clientY - box.top);
      return new THREE.Ray(origin, direction).intersectPlane(plane, new THREE.Vector3());
    },

    onMove(event) {
      if (!this.held) {
        this.moving = event; // looked at once a frame
        return;
      }
      const { from } = this.held;
      if (!this.held.moved && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < DRAG_STARTS_PX) return;
      this.held.moved = true;
      this.held.last = event;
      this.pull(event);
    },

    pull(event) {
      const { plane, kind, offset, handle } = this.held;
      const target = this.onPlane(event, plane, kind)?.add(offset);
      if (!target) return;
      for (const one of this.kinds) this.bodies[one].target = target.toArray();
      const before = this.stream.sequence;
      this.stream.drag(handle, target.toArray(), this.kinds.indexOf(kind));
      this.held.since ??= new Map();
      if (this.stream.sequence > before) this.held.since.set(this.stream.sequence, event.timeStamp);
      this.mark();
    },

    onWheel(event) {
      if (!this.held) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      this.held.plane.constant -= PUSH_MM * -event.deltaY; // wheel up: away from the viewer
      this.held.moved = true;
      if (this.held.last) this.pull(this.held.last);
    },

    onUp(event) {
      if (!this.held) return;
      const { moved } = this.held;
      this.letGo();
      if (moved) this.stream.ask("release");
      this.moving = event;
    },

    letGo() {
      this.held = null;
      for (const kind of this.kinds) this.bodies[kind].target = null;
      this.mark();
    },

    cancel() {
      if (!this.held) return;
      this.letGo();
      this.stream.waiting = null;
      this.stream.ask("cancel");
    },

    togglePin(handle, kind) {
      const pinned = this.bodies[kind].pins.some(([one]) => one === handle);
      this.stream.ask(pinned ? "unpin" : "pin", { vertex: handle });
    },

    /** Show what is under the mouse. */
    point(found) {
      const handle = found ? found.handle : -1;
      const region = found ? found.region : -1;
      const changed = region !== (this.hover?.region ?? -1);
      this.hover = found && handle >= 0 ? found : null;
      this.$refs.canvas.style.cursor = handle < 0 ? "" : this.held ? "grabbing" : "grab";
      for (const kind of this.kinds) {
        const body = this.bodies[kind];
        body.active = handle;
        body.cursor = found && handle >= 0 && (kind === found.kind || this.held) ? found.point : null;
        if (changed) body.setLook({ hovered: kind === "region" ? region : -1 });
        else body.mark();
      }
      const name = region >= 0 ? this.shared.regions[region] : "";
      this.$refs.hint.textContent = handle < 0 ? "" : `${found.kind === "region" ? `${name} · ` : ""}vertex ${handle}`;
      this.dirty = true;
    },

    mark() {
      Object.values(this.bodies).forEach((body) => body.mark());
      this.dirty = true;
    },

    onKeyDown(event) {
      const { key } = event;
      if (/^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName) && event.target.type !== "range") return;
      if (event.target.isContentEditable) return;
      const plain = !event.ctrlKey && !event.metaKey && !event.altKey;
      const small = key.toLowerCase();
      if ((event.ctrlKey || event.metaKey) && small === "z") this.stream.ask(event.shiftKey ? "redo" : "undo");
      else if ((event.ctrlKey || event.metaKey) && small === "y") this.stream.ask("redo");
      else if (plain && key === "Escape") this.cancel();
      else if (plain && key === " ") this.stream.ask("play or pause");
      else if (plain && small === "p" && this.hover) this.togglePin(this.hover.handle, this.hover.kind);
      else if (plain && small === "f") this.lookFrom(0, 0);
      else if (plain && small in { k: 1, s: 1, r: 1, d: 1, h: 1, c: 1, w: 1 } && !event.repeat) this.$emit("shortcut", small);
      else if (plain && /^Arrow(Left|Right)$|^Home$|^End$|^Delete$/.test(key)) this.$emit("shortcut", key);
      else return;
      event.preventDefault();
      if (document.activeElement?.tagName === "BUTTON") document.activeElement.blur();
    },

    // Every frame

    step() {
      if (this.stage.controls.update()) this.dirty = true;
      this.stream.flush();
      if (this.held?.since && this.stream.sentAt.size && !this.held.since.has(this.stream.sequence)) {
        this.held.since.set(this.stream.sequence, this.held.last?.timeStamp ?? performance.now());
      }
      if (this.moving && !this.held) {
        const event = this.moving;
        this.moving = null;
        this.point(event.buttons ? null : this.pick(event));
      }
      const begun = performance.now();
      const still = this.pace.due(begun); // nothing moves: once more, finely
      if (!this.dirty && !still) return;
      this.dirty = false;
      if (!still) this.pace.begin(begun);
      this.draw();
      if (still) {
        this.stage.finish();
        this.pace.took(performance.now() - begun);
      }
      const now = performance.now();
      this.pace.end(now);
      this.frames.push(now);
      if (this.frames.length > 600) this.frames.shift();
      if (this.held?.since?.has(this.arrived)) {
        this.answers.push(now - this.held.since.get(this.arrived));
        this.held.since.delete(this.arrived);
        if (this.answers.length > 600) this.answers.shift();
      }
    },

    /** Light the faces fully, or quickly by pictures of spheres. */
    lightFaces(quickly) {
      if (quickly && !this.spheres) {
        this.spheres = {};
        for (const [look, values] of Object.entries(LOOKS)) {
          const material = new THREE.MeshStandardMaterial({ ...values, color: 0xffffff });
          this.spheres[look] = this.stage.sphereLight(material);
          material.dispose();
        }
      }
      for (const body of Object.values(this.bodies)) body.lightBy(quickly ? this.spheres : null);
    },

    draw() {
      this.stage.draw((column) => {
        for (const kind of this.kinds) this.bodies[kind].group.visible = kind === this.shown[column];
      });
    },

    /** What tests and measurements read. */
    probe() {
      const view = this;
      return {
        ready: () => view.stream.socket.readyState === WebSocket.OPEN && view.arrived !== undefined,
        kinds: () => [...view.kinds],
        shown: () => [...view.shown],
        regions: () => [...view.shared.regions],
        positions: (kind) => Array.from(view.bodies[kind].positions),
        handles: () => Array.from(view.shared.handles),
        handleRegion: () => Array.from(view.shared.handleRegion),
        rest: () => Array.from(view.shared.positions),
        pins: (kind) => view.bodies[kind].pins,
        /** Client coordinates of a control point in the view of a kind, and the control point a click there finds. */
        place: (handle, kind) => {
          const box = view.$refs.canvas.getBoundingClientRect();
          const [x, y] = view.stage.project(view.bodies[kind].handlePosition(handle), view.shown.indexOf(kind));
          const found = view.pick({ clientX: x + box.left, clientY: y + box.top });
          return { x: x + box.left, y: y + box.top, handle: found ? found.handle : -1 };
        },
        measured: () => ({
          roundTrips: [...view.stream.roundTrips], answers: [...view.answers], frames: [...view.frames],
        }),
        /** Milliseconds that drawing takes to its end, n times, with a share of the full resolution. */
        drawing: (n, share = 1, quickly = false) => {
          view.stage.sharpen(share);
          view.lightFaces(quickly);
          const took = [];
          for (let k = 0; k < n; k++) {
            const begun = performance.now();
            view.draw();
            view.stage.finish();
            took.push(performance.now() - begun);
          }
          view.stage.sharpen(1);
          view.lightFaces(false);
          return took;
        },
        quick: (quickly) => {
          view.lightFaces(quickly);
          view.dirty = true;
        },
        renderer: () => view.stage.name(),
        forget: () => {
          view.stream.roundTrips.length = view.answers.length = view.frames.length = 0;
        },
      };
    },
  },
};
