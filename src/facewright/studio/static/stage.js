// Renderer, light and camera: the room in which the face stands.
import { THREE, OrbitControls } from "nicegui-scene";

const FIELD_OF_VIEW = 23;
const FRAME = { height: 1.8, width: 1.75 }; // what the view shows, in heights and widths of the face

/** Soft boxes in a dark room, as image-based light. */
function studioLight(renderer) {
  const room = new THREE.Scene();
  room.background = new THREE.Color(0.035, 0.038, 0.045);
  const panel = (width, height, x, y, z, colour, strength) => {
    const material = new THREE.MeshBasicMaterial({ color: new THREE.Color(colour).multiplyScalar(strength) });
    material.side = THREE.DoubleSide;
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(width, height), material);
    mesh.position.set(x, y, z);
    mesh.lookAt(0, 0, 0);
    room.add(mesh);
  };
  panel(5, 4, -4.5, 4, 4.5, 0xfff1e2, 7.0); // key, above the viewer's left
  panel(5, 5, 6, 0.5, 3, 0xdfe9ff, 1.3); // fill
  panel(3, 6, -6, 1.5, -4, 0xbcd2ff, 4.5); // rims
  panel(3, 6, 6, 2, -4, 0xffd9bd, 3.0);
  panel(8, 4, 0, 7, 0, 0xffffff, 1.4);
  panel(8, 8, 0, -5, 2.5, 0xb08a76, 1.3);
  const generator = new THREE.PMREMGenerator(renderer);
  const texture = generator.fromScene(room, 0.02).texture;
  generator.dispose();
  return texture;
}

export class Stage {
  constructor(canvas) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.renderer.toneMappingExposure = 1.0;
    this.renderer.autoClear = false;
    this.renderer.setClearColor(0x000000, 0);
    this.scene = new THREE.Scene();
    this.scene.environment = studioLight(this.renderer);
    const key = new THREE.DirectionalLight(0xfff2e4, 1.55);
    key.position.set(-260, 330, 420);
    const rim = new THREE.DirectionalLight(0xcfe0ff, 0.9);
    rim.position.set(330, 160, -300);
    this.scene.add(key, rim);
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 40, 4000);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.18;
    this.controls.rotateSpeed = 0.75;
    this.controls.minDistance = 120;
    this.controls.maxDistance = 2500;
    this.pixels = { value: 1 }; // device pixels of a dot's pixel, for shaders
    this.share = 1; // of the full resolution, less while a slow renderer has to keep up
    this.width = this.height = 1;
    this.columns = 1;
    this.extent = { centre: new THREE.Vector3(), width: 160, height: 210 };
    this.direction = new THREE.Vector3(0, 0, 1);
  }

  /** Picture of a lit sphere as the camera sees it: lights surfaces by their normals alone, at little cost. */
  sphereLight(material, size = 160) {
    const target = new THREE.WebGLRenderTarget(size, size, { type: THREE.HalfFloatType, samples: 4 });
    const ball = new THREE.Mesh(new THREE.SphereGeometry(1, 96, 64), material);
    const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 10);
    const away = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 2);
    camera.position.copy(away).multiplyScalar(5);
    camera.up.setFromMatrixColumn(this.camera.matrixWorld, 1);
    camera.lookAt(0, 0, 0);
    const others = this.scene.children.filter((one) => one.visible && !one.isLight);
    others.forEach((one) => (one.visible = false));
    this.scene.add(ball);
    const { toneMapping } = this.renderer;
    this.renderer.toneMapping = THREE.NoToneMapping;
    this.renderer.setScissorTest(false);
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    this.renderer.render(this.scene, camera);
    this.renderer.setRenderTarget(null);
    this.renderer.toneMapping = toneMapping;
    this.scene.remove(ball);
    others.forEach((one) => (one.visible = true));
    ball.geometry.dispose();
    return target.texture;
  }

  /** Remember what is to be framed and look at it. */
  frame(extent) {
    this.extent = extent;
    this.look(0, 0);
  }

  /** Look at the face from yaw and pitch in degrees (0, 0: from the front). */
  look(yaw, pitch) {
    const [a, b] = [THREE.MathUtils.degToRad(yaw), THREE.MathUtils.degToRad(pitch)];
    this.direction.set(Math.sin(a) * Math.cos(b), Math.sin(b), Math.cos(a) * Math.cos(b));
    const half = Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW / 2));
    const aspect = this.width / this.columns / this.height;
    const { centre, width, height } = this.extent;
    const distance = Math.max((FRAME.height * height) / 2 / half, (FRAME.width * width) / 2 / half / aspect);
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).addScaledVector(this.direction, distance);
    this.controls.update();
  }

  resize(width, height, columns) {
    const before = this.width / this.columns / this.height;
    this.width = Math.max(1, width);
    this.height = Math.max(1, height);
    this.columns = columns;
    this.sharpen(this.share);
    this.camera.aspect = this.width / columns / this.height;
    this.camera.updateProjectionMatrix();
    const half = Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW / 2));
    const room = (aspect) =>
      Math.max((FRAME.height * this.extent.height) / 2 / half, (FRAME.width * this.extent.width) / 2 / half / aspect);
    const step = room(this.camera.aspect) / room(before); // the face keeps its share of the view
    const arm = this.camera.position.clone().sub(this.controls.target);
    this.camera.position.copy(this.controls.target).addScaledVector(arm, step);
    this.controls.update();
  }

  /** Draw with a share of the full resolution. */
  sharpen(share) {
    this.share = share;
    this.renderer.setPixelRatio(share * Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(this.width, this.height, false);
  }

  /** Which column of the view a place in the canvas is in, and the ray through it. */
  ray(x, y) {
    const wide = this.width / this.columns;
    const column = Math.min(this.columns - 1, Math.max(0, Math.floor(x / wide)));
    const place = new THREE.Vector2((2 * (x - column * wide)) / wide - 1, 1 - (2 * y) / this.height);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(place, this.camera);
    return { column, origin: caster.ray.origin, direction: caster.ray.direction };
  }

  /** Where a point of the scene is drawn in the canvas, in a column of it. */
  project(point, column) {
    const wide = this.width / this.columns;
    const seen = new THREE.Vector3(...point).project(this.camera);
    return [((seen.x + 1) / 2 + column) * wide, ((1 - seen.y) / 2) * this.height];
  }

  /** Draw: `show(column)` makes visible what belongs there. */
  draw(show) {
    const wide = this.width / this.columns;
    this.renderer.setScissorTest(false);
    this.renderer.clear();
    this.renderer.setScissorTest(true);
    for (let column = 0; column < this.columns; column++) {
      show(column);
      this.pixels.value = this.renderer.getPixelRatio();
      this.renderer.setViewport(column * wide, 0, wide, this.height);
      this.renderer.setScissor(column * wide, 0, wide, this.height);
      this.renderer.render(this.scene, this.camera);
    }
  }

  /** Wait until all is drawn. */
  finish() {
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  /** Name of what draws. */
  name() {
    const gl = this.renderer.getContext();
    const details = gl.getExtension("WEBGL_debug_renderer_info");
    return details ? gl.getParameter(details.UNMASKED_RENDERER_WEBGL) : "unknown";
  }

  dispose() {
    this.controls.dispose();
    this.renderer.dispose();
  }
}
