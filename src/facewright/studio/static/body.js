// A posed face: its surface, its control points, pins, and the vertex that is held.
import { THREE } from "nicegui-scene";
import { firstHit, vertexNormals } from "facewright-studio/geometry.js";

const CLAY = { skin: [0.71, 0.66, 0.62], eyes: [0.86, 0.86, 0.87], teeth: [0.85, 0.84, 0.8], mouth: [0.42, 0.25, 0.24] };
export const LOOKS = {
  skin: { roughness: 0.6, envMapIntensity: 0.66 },
  eyes: { roughness: 0.07, envMapIntensity: 1.1 },
  teeth: { roughness: 0.25, envMapIntensity: 0.7 },
  mouth: { roughness: 0.45, envMapIntensity: 0.35 },
};
const NEAR_MM = 24; // control points within this of the cursor show

const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

const DOTS_VERTEX = `
  attribute vec4 tint;
  attribute float size;
  uniform float ratio;
  varying vec4 colour;
  varying float edge;
  void main() {
    colour = tint;
    edge = 2.0 / (size * ratio);
    vec4 eye = modelViewMatrix * vec4(position, 1.0);
    eye.xyz *= 1.0 - 2.2 / length(eye.xyz);  // a little in front of the skin
    gl_Position = projectionMatrix * eye;
    gl_PointSize = size * ratio;
    if (tint.a < 0.02) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // nowhere
  }`;
const DOTS_FRAGMENT = `
  varying vec4 colour;
  varying float edge;
  void main() {
    float r = 2.0 * length(gl_PointCoord - 0.5);
    float inside = 1.0 - smoothstep(1.0 - edge, 1.0, r);
    if (colour.a * inside < 0.01) discard;
    vec3 shade = mix(colour.rgb, vec3(0.06, 0.07, 0.09), smoothstep(0.62, 0.62 + edge, r));
    gl_FragColor = vec4(shade, colour.a * inside);
  }`;

/** Lay the colour of the attribute `tint` over a material's own. */
function tinted(material) {
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = `attribute vec4 tint;\nvarying vec4 vTint;\n${shader.vertexShader}`.replace(
      "#include <color_vertex>", "#include <color_vertex>\nvTint = tint;",
    );
    shader.fragmentShader = `varying vec4 vTint;\n${shader.fragmentShader}`.replace(
      "#include <color_fragment>", "#include <color_fragment>\ndiffuseColor.rgb = mix(diffuseColor.rgb, vTint.rgb, vTint.a);",
    );
  };
  return material;
}

/** Round dots of a fixed size in pixels. */
class Dots {
  constructor(count, depthTest, ratio) {
    this.count = count;
    this.geometry = new THREE.BufferGeometry();
    this.positions = new Float32Array(3 * count);
    this.tints = new Float32Array(4 * count);
    this.sizes = new Float32Array(count);
    const attribute = (array, width) => new THREE.BufferAttribute(array, width).setUsage(THREE.DynamicDrawUsage);
    this.geometry.setAttribute("position", attribute(this.positions, 3));
    this.geometry.setAttribute("tint", attribute(this.tints, 4));
    this.geometry.setAttribute("size", attribute(this.sizes, 1));
    this.material = new THREE.ShaderMaterial({
      vertexShader: DOTS_VERTEX,
      fragmentShader: DOTS_FRAGMENT,
      uniforms: { ratio },
      transparent: true,
      depthTest,
      depthWrite: false,
    });
    this.object = new THREE.Points(this.geometry, this.material);
    this.object.frustumCulled = false;
    this.object.renderOrder = depthTest ? 2 : 4;
  }

  changed() {
    for (const name of ["position", "tint", "size"]) this.geometry.attributes[name].needsUpdate = true;
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}

export class Body {
  /** `shared`: what all views of the face have in common, see `fetchShared`; `pixels`: a uniform, see `Stage`. */
  constructor(shared, pixels) {
    this.shared = shared;
    this.positions = new Float32Array(shared.positions);
    this.normals = new Float32Array(this.positions.length);
    const U = shared.source.length; // vertices as drawn: more than V where the atlas has seams
    this.drawn = { position: new Float32Array(3 * U), normal: new Float32Array(3 * U), color: new Float32Array(3 * U), tint: new Float32Array(4 * U) };
    this.group = new THREE.Group();
    this.geometry = new THREE.BufferGeometry();
    const attribute = (array, width = 3) => new THREE.BufferAttribute(array, width).setUsage(THREE.DynamicDrawUsage);
    for (const [name, array] of Object.entries(this.drawn)) this.geometry.setAttribute(name, attribute(array, name === "tint" ? 4 : 3));
    if (shared.uv) this.geometry.setAttribute("uv", new THREE.BufferAttribute(shared.uv, 2));
    this.geometry.setIndex(new THREE.BufferAttribute(shared.drawnFaces, 1));
    this.materials = shared.groups.map(({ look }) => tinted(new THREE.MeshStandardMaterial({ vertexColors: true, side: THREE.DoubleSide, ...LOOKS[look] })));
    shared.groups.forEach(({ start, count }, k) => this.geometry.addGroup(start, count, k));
    this.quick = shared.groups.map(() => tinted(new THREE.MeshMatcapMaterial({ vertexColors: true, side: THREE.DoubleSide })));
    this.mesh = new THREE.Mesh(this.geometry, this.materials);
    this.mesh.frustumCulled = false;
    this.wires = new THREE.Mesh(
      this.geometry,
      shared.groups.map(
        ({ look }) =>
          new THREE.MeshBasicMaterial({
            color: 0x10131a, wireframe: true, transparent: true, opacity: 0.16, depthWrite: false, visible: look === "skin",
          }),
      ),
    );
    this.wires.frustumCulled = false;
    this.wires.visible = false;
    this.wires.renderOrder = 1;
    this.handles = new Dots(shared.handles.length, true, pixels);
    this.marks = new Dots(2 * 64 + 4, false, pixels);
    this.line = new THREE.LineSegments(
      new THREE.BufferGeometry().setAttribute("position", attribute(new Float32Array(3 * 2 * 66))),
      new THREE.LineBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.55, depthTest: false }),
    );
    this.line.frustumCulled = false;
    this.line.renderOrder = 3;
    this.group.add(this.mesh, this.wires, this.handles.object, this.line, this.marks.object);
    this.look = { regions: false, paint: true, handles: false, hovered: -1 };
    this.cursor = null; // where the mouse meets the skin
    this.active = -1; // handle under the mouse, or held
    this.target = null; // where it is pulled
    this.pins = []; // [handle, x, y, z]
    this.place(this.positions);
    this.paint();
  }

  /** Take new vertex positions. */
  place(positions) {
    if (positions !== this.positions) this.positions.set(positions);
    vertexNormals(this.positions, this.shared.faces, this.normals);
    const { source } = this.shared;
    const { position, normal } = this.drawn;
    for (let u = 0; u < source.length; u++) {
      const v = 3 * source[u];
      for (let c = 0; c < 3; c++) {
        position[3 * u + c] = this.positions[v + c];
        normal[3 * u + c] = this.normals[v + c];
      }
    }
    this.geometry.attributes.position.needsUpdate = true;
    this.geometry.attributes.normal.needsUpdate = true;
    this.mark();
  }

  /** Colour the skin: paint or clay, regions laid over it, the one under the mouse a little brighter. */
  paint() {
    const { shared, look } = this;
    const { color, tint } = this.drawn;
    const V = this.positions.length / 3;
    const pictured = look.paint && shared.picture;
    shared.groups.forEach(({ look: name }, k) => {
      const map = pictured && name === "skin" ? shared.picture : null;
      for (const material of [this.materials[k], this.quick[k]]) {
        if (material.map === map) continue;
        material.map = map;
        material.needsUpdate = true;
      }
    });
    for (let u = 0; u < shared.source.length; u++) {
      const v = shared.source[u];
      const name = shared.looks[shared.lookOf[v]];
      const inside = look.hovered >= 0 ? shared.membership[look.hovered * V + v] / 255 : 0;
      const reach = shared.regionColours[4 * v + 3] / 255;
      for (let c = 0; c < 3; c++) {
        let base = CLAY[name][c];
        if (look.paint && shared.colours) base = shared.colours[3 * v + c] / 255;
        color[3 * u + c] = (pictured && name === "skin" ? 1 : linear(base)) * (shared.shade[v] / 255);
        tint[4 * u + c] = linear(Math.min(1, (shared.regionColours[4 * v + c] / 255) * (1 + 0.15 * inside)));
      }
      tint[4 * u + 3] = name === "skin" ? reach * (look.regions ? 0.6 + 0.2 * inside : 0.26 * inside) : 0;
    }
    this.geometry.attributes.color.needsUpdate = true;
    this.geometry.attributes.tint.needsUpdate = true;
  }

  /** Light the face with pictures of a sphere, one for each look, or (null) fully. */
  lightBy(spheres) {
    if (spheres) {
      this.quick.forEach((material, k) => {
        const sphere = spheres[this.shared.groups[k].look];
        if (material.matcap !== sphere) material.needsUpdate = material.matcap === null;
        material.matcap = sphere;
      });
    }
    this.mesh.material = spheres ? this.quick : this.materials;
  }

  setLook(changes) {
    Object.assign(this.look, changes);
    this.wires.visible = Boolean(this.look.wires);
    this.paint();
    this.mark();
  }

  handlePosition(handle) {
    const v = 3 * this.shared.handles[handle];
    return [this.positions[v], this.positions[v + 1], this.positions[v + 2]];
  }

  /** Lay out control points, pins and what is held. */
  mark() {
    const { handles, shared, positions, cursor, active } = this;
    const pinned = new Set(this.pins.map(([handle]) => handle));
    for (let k = 0; k < handles.count; k++) {
      const v = 3 * shared.handles[k];
      const [x, y, z] = [positions[v], positions[v + 1], positions[v + 2]];
      handles.positions.set([x, y, z], 3 * k);
      let alpha = this.look.handles ? 0.5 : 0;
      if (cursor) {
        const away = Math.hypot(x - cursor[0], y - cursor[1], z - cursor[2]);
        alpha = Math.max(alpha, 0.75 * Math.max(0, 1 - away / NEAR_MM));
      }
      if (pinned.has(k) || k === active) alpha = 0;
      handles.tints.set([0.93, 0.95, 1.0, alpha], 4 * k);
      handles.sizes[k] = 5;
    }
    handles.changed();
    const { marks } = this;
    const lines = this.line.geometry.attributes.position;
    let n = 0, segments = 0;
    const dot = (place, size, r, g, b, a) => {
      marks.positions.set(place, 3 * n);
      marks.tints.set([r, g, b, a], 4 * n);
      marks.sizes[n++] = size;
    };
    const pull = (from, to) => {
      if (Math.hypot(from[0] - to[0], from[1] - to[1], from[2] - to[2]) < 0.4) return;
      lines.array.set([...from, ...to], 6 * segments++);
      dot(to, 7, 0.78, 0.8, 0.85, 0.85);
    };
    for (const [handle, ...target] of this.pins.slice(0, 62)) {
      if (handle !== active || !this.target) pull(this.handlePosition(handle), target);
      dot(this.handlePosition(handle), 12, 0.36, 0.78, 1.0, 1);
    }
    if (active >= 0) {
      if (this.target) pull(this.handlePosition(active), this.target);
      dot(this.handlePosition(active), this.target ? 13 : 11, 1.0, 0.8, 0.25, 1);
    }
    for (; n < marks.count; n++) marks.tints[4 * n + 3] = 0;
    marks.changed();
    lines.needsUpdate = true;
    this.line.geometry.setDrawRange(0, 2 * segments);
  }

  /** What a ray meets: {handle, region, point}, handle -1 where the face cannot be dragged; null for nothing. */
  pick(ray) {
    const hit = firstHit(this.positions, this.shared.faces, ray.origin, ray.direction);
    if (!hit) return null;
    const handle = this.shared.nearest[hit.corner];
    return { handle, region: handle < 0 ? -1 : this.shared.handleRegion[handle], point: hit.point };
  }

  dispose() {
    this.geometry.dispose();
    [...this.materials, ...this.quick].forEach((material) => material.dispose());
    this.wires.material.forEach((material) => material.dispose());
    this.handles.dispose();
    this.marks.dispose();
    this.line.geometry.dispose();
    this.line.material.dispose();
  }
}
