// The binary line to the session: drags go out, positions come back, the latest wins.

import { THREE } from "nicegui-scene";

const MAX_UNANSWERED = 2; // drags on their way before newer ones wait (and replace each other)
const DRAG = 1;
const POSE = 1;

export class Stream {
  /** `on`: {pose(kinds, time), state(object), open(), closed()}. */
  constructor(path, on) {
    this.url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;
    this.on = on;
    this.sequence = 0;
    this.answered = 0;
    this.waiting = null;
    this.sentAt = new Map();
    this.roundTrips = []; // ms from sending a drag to its positions being here
    this.stopped = false;
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(this.url);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.answered = this.sequence;
      this.waiting = null;
      this.on.open();
    };
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.on.state(JSON.parse(data));
      else this.receive(data);
    };
    this.socket.onclose = () => {
      if (this.stopped) return;
      this.on.closed();
      setTimeout(() => this.stopped || this.connect(), 1000);
    };
  }

  receive(data) {
    const [tag, sequence, kinds, V] = new Uint32Array(data, 0, 4);
    if (tag !== POSE) return;
    const [time] = new Float32Array(data, 16, 1);
    const views = [];
    for (let k = 0; k < kinds; k++) views.push(new Float32Array(data, 32 + 12 * V * k, 3 * V));
    if (this.sentAt.has(sequence)) {
      this.roundTrips.push(performance.now() - this.sentAt.get(sequence));
      if (this.roundTrips.length > 600) this.roundTrips.shift();
    }
    for (const one of this.sentAt.keys()) if (one <= sequence) this.sentAt.delete(one);
    this.answered = Math.max(this.answered, sequence);
    this.on.pose(views, time, sequence);
  }

  /** Pull a control point of one kind of model towards a place; an older pull that still waits is forgotten. */
  drag(handle, target, kind) {
    this.waiting = [handle, ...target, kind];
    this.flush();
  }

  /** Send what waits if the line is free; called on every frame. */
  flush(force = false) {
    if (!this.waiting || this.socket.readyState !== WebSocket.OPEN) return;
    if (!force && this.sequence - this.answered >= MAX_UNANSWERED) return;
    this.sequence += 1;
    const [handle, x, y, z, kind] = this.waiting;
    this.waiting = null;
    const message = new ArrayBuffer(28);
    new Uint32Array(message, 0, 4).set([DRAG, this.sequence, handle, kind]);
    new Float32Array(message, 16, 3).set([x, y, z]);
    this.sentAt.set(this.sequence, performance.now());
    this.socket.send(message);
  }

  /** Ask for something; what was dragged before goes first. */
  ask(what, details = {}) {
    this.flush(true);
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ do: what, ...details }));
  }

  close() {
    this.stopped = true;
    this.socket.close();
  }
}

/** Fetch what does not change: see `PoseBody.packet` in pose_body.py. */
export async function fetchShared(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`the face could not be loaded (${response.status})`);
  const data = await response.arrayBuffer();
  const [size] = new Uint32Array(data, 0, 1);
  const { arrays, ...shared } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
  const types = { f4: Float32Array, u4: Uint32Array, i4: Int32Array, u1: Uint8Array };
  for (const [name, [type, offset, length]] of Object.entries(arrays)) shared[name] = new types[type](data, offset, length);
  if (shared.skin) {
    const bitmap = await createImageBitmap(new Blob([shared.skin], { type: "image/png" }));
    shared.picture = new THREE.Texture(bitmap);
    shared.picture.flipY = false;
    shared.picture.colorSpace = THREE.SRGBColorSpace;
    shared.picture.anisotropy = 4;
    shared.picture.needsUpdate = true;
  }
  return shared;
}
