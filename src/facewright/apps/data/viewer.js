// Shows one .glb (positions, texture, named morph targets) in plain WebGL: drag to turn, wheel to zoom, sliders to move.
// No library and no network: the page works from a folder on disk.
"use strict";

function parseGlb(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== 0x46546c67) throw new Error("not a .glb file");
  const jsonLength = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, jsonLength)));
  const binStart = 20 + jsonLength + 8;
  const sizes = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };
  const types = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
  function read(index) {
    const a = json.accessors[index];
    const n = a.count * sizes[a.type];
    if (a.bufferView === undefined) return new types[a.componentType](n);
    const bv = json.bufferViews[a.bufferView];
    const start = binStart + (bv.byteOffset || 0) + (a.byteOffset || 0);
    const bytes = types[a.componentType].BYTES_PER_ELEMENT * n;
    return new types[a.componentType](buffer.slice(start, start + bytes));
  }
  function image(index) {
    const source = json.images[json.textures[index].source];
    const bv = json.bufferViews[source.bufferView];
    return new Blob([new Uint8Array(buffer, binStart + (bv.byteOffset || 0), bv.byteLength)], { type: source.mimeType });
  }
  return { json, read, image };
}

async function showGlb(canvas, buffer, onTargets) {
  const glb = parseGlb(buffer);
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) throw new Error("this browser has no WebGL");
  const uints = gl.getExtension("OES_element_index_uint");
  if (!uints) throw new Error("this browser's WebGL has no 32-bit indices");
  const vertex = `attribute vec3 p; attribute vec3 n; attribute vec2 t; attribute vec3 k; uniform mat4 m; uniform mat3 r; varying vec3 vn; varying vec2 vt; varying vec3 vk;
    void main() { gl_Position = m * vec4(p, 1.0); vn = r * n; vt = t; vk = k; }`;
  const fragment = `precision mediump float; varying vec3 vn; varying vec2 vt; varying vec3 vk; uniform sampler2D s; uniform vec4 c; uniform float lit;
    void main() { vec3 n = normalize(vn); float d = 0.55 + 0.35 * max(dot(n, normalize(vec3(-0.4, 0.5, 0.8))), 0.0) + 0.15 * n.y;
      vec3 linear = pow(texture2D(s, vt).rgb, vec3(2.2)) * c.rgb * vk * mix(1.0, d, lit);
      gl_FragColor = vec4(pow(linear, vec3(1.0 / 2.2)), 1.0); }`;
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);

  async function texture(material) {
    const handle = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, handle);
    const info = material && material.pbrMetallicRoughness && material.pbrMetallicRoughness.baseColorTexture;
    if (info) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, await createImageBitmap(glb.image(info.index)));
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([255, 255, 255, 255]));
    for (const [key, value] of [[gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE], [gl.TEXTURE_MIN_FILTER, gl.LINEAR]])
      gl.texParameteri(gl.TEXTURE_2D, key, value);
    return { handle, textured: Boolean(info) };
  }

  function readColours(primitive, count) { // linear, as glTF has it
    const rgb = new Float32Array(count * 3).fill(1);
    if (primitive.attributes.COLOR_0 === undefined) return rgb;
    const data = glb.read(primitive.attributes.COLOR_0);
    const stride = data.length / count, top = data instanceof Uint8Array ? 255 : data instanceof Uint16Array ? 65535 : 1;
    for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) rgb[i * 3 + k] = data[i * stride + k] / top;
    return rgb;
  }

  const parts = [];
  let names = [];
  for (const mesh of glb.json.meshes) {
    names = (mesh.extras && mesh.extras.targetNames) || names;
    for (const primitive of mesh.primitives) {
      const base = glb.read(primitive.attributes.POSITION);
      const material = glb.json.materials && glb.json.materials[primitive.material];
      const colour = (material && material.pbrMetallicRoughness && material.pbrMetallicRoughness.baseColorFactor) || [1, 1, 1, 1];
      parts.push({
        base, colour, positions: new Float32Array(base), normals: new Float32Array(base.length),
        indices: Uint32Array.from(glb.read(primitive.indices)),
        uv: primitive.attributes.TEXCOORD_0 === undefined ? new Float32Array((base.length / 3) * 2) : glb.read(primitive.attributes.TEXCOORD_0),
        colours: readColours(primitive, base.length / 3),
        targets: (primitive.targets || []).map((target) => glb.read(target.POSITION)),
        buffers: [0, 1, 2, 3, 4].map(() => gl.createBuffer()),
        texture: await texture(material),
      });
    }
  }
  const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
  for (const part of parts) for (let i = 0; i < part.base.length; i++) {
    low[i % 3] = Math.min(low[i % 3], part.base[i]);
    high[i % 3] = Math.max(high[i % 3], part.base[i]);
  }
  const centre = low.map((v, k) => (v + high[k]) / 2), radius = Math.hypot(...high.map((v, k) => (v - low[k]) / 2));
  const state = { yaw: 0.35, pitch: 0.05, zoom: 2.7, weights: new Float32Array(names.length) };

  function upload() {
    for (const part of parts) {
      part.positions.set(part.base);
      part.targets.forEach((target, k) => {
        const w = state.weights[k];
        if (w !== 0) for (let i = 0; i < target.length; i++) part.positions[i] += w * target[i];
      });
      const p = part.positions, n = part.normals.fill(0), f = part.indices;
      for (let i = 0; i < f.length; i += 3) {
        const a = f[i] * 3, b = f[i + 1] * 3, c = f[i + 2] * 3;
        const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
        const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
        const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
        for (const k of [a, b, c]) { n[k] += x; n[k + 1] += y; n[k + 2] += z; }
      }
      [part.positions, part.normals, part.uv, part.colours].forEach((data, k) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, part.buffers[k]);
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.buffers[4]);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, part.indices, gl.STATIC_DRAW);
    }
    draw();
  }

  function draw() {
    const scale = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * scale;
    canvas.height = canvas.clientHeight * scale;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.94, 0.94, 0.95, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), cp = Math.cos(state.pitch), sp = Math.sin(state.pitch);
    const r = [cy, sp * sy, -cp * sy, 0, cp, sp, sy, -sp * cy, cp * cy]; // columns of pitch * yaw
    const d = radius * state.zoom, f = 3.2, aspect = canvas.width / canvas.height, near = d / 20, far = d * 4;
    const t = [0, 1, 2].map((row) => -(r[row] * centre[0] + r[3 + row] * centre[1] + r[6 + row] * centre[2]));
    const a = (far + near) / (near - far), b = (2 * far * near) / (near - far);
    const m = [];
    for (let column = 0; column < 4; column++) {
      const x = column < 3 ? r[column * 3] : t[0], y = column < 3 ? r[column * 3 + 1] : t[1], z = column < 3 ? r[column * 3 + 2] : t[2] - d;
      m.push((f / aspect) * x, f * y, a * z + (column === 3 ? b : 0), -z);
    }
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "m"), false, m);
    gl.uniformMatrix3fv(gl.getUniformLocation(program, "r"), false, r);
    for (const part of parts) {
      ["p", "n", "t", "k"].forEach((name, k) => {
        const location = gl.getAttribLocation(program, name);
        gl.bindBuffer(gl.ARRAY_BUFFER, part.buffers[k]);
        gl.enableVertexAttribArray(location);
        gl.vertexAttribPointer(location, k === 2 ? 2 : 3, gl.FLOAT, false, 0, 0);
      });
      gl.bindTexture(gl.TEXTURE_2D, part.texture.handle);
      gl.uniform4fv(gl.getUniformLocation(program, "c"), part.colour);
      gl.uniform1f(gl.getUniformLocation(program, "lit"), part.texture.textured ? 0.35 : 1.0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.buffers[4]);
      gl.drawElements(gl.TRIANGLES, part.indices.length, gl.UNSIGNED_INT, 0);
    }
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    state.yaw += event.movementX * 0.01;
    state.pitch = Math.max(-1.2, Math.min(1.2, state.pitch + event.movementY * 0.01));
    draw();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.zoom = Math.max(1.2, Math.min(6, state.zoom * Math.exp(event.deltaY * 0.001)));
    draw();
  }, { passive: false });
  window.addEventListener("resize", draw);
  upload();
  let pending = false;
  onTargets(names, (k, weight) => {
    state.weights[k] = weight;
    if (!pending) requestAnimationFrame(() => { pending = false; upload(); }); // many sliders at once: one redraw
    pending = true;
  });
}
