// Arithmetic on packed arrays of a triangle mesh: normals, and where a ray meets it.

/** Write unit vertex normals of `positions` (3V) with triangles `faces` (3F) into `normals` (3V). */
export function vertexNormals(positions, faces, normals) {
  normals.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f];
    const b = 3 * faces[f + 1];
    const c = 3 * faces[f + 2];
    const ax = positions[a], ay = positions[a + 1], az = positions[a + 2];
    const ux = positions[b] - ax, uy = positions[b + 1] - ay, uz = positions[b + 2] - az;
    const vx = positions[c] - ax, vy = positions[c + 1] - ay, vz = positions[c + 2] - az;
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx; // twice the area long
    normals[a] += nx; normals[a + 1] += ny; normals[a + 2] += nz;
    normals[b] += nx; normals[b + 1] += ny; normals[b + 2] += nz;
    normals[c] += nx; normals[c + 1] += ny; normals[c + 2] += nz;
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    normals[i] /= length; normals[i + 1] /= length; normals[i + 2] /= length;
  }
}

/** Return {face, distance, point, corner} of the first triangle that faces the ray, or null; corner: nearest vertex. */
export function firstHit(positions, faces, origin, direction) {
  const { x: ox, y: oy, z: oz } = origin;
  const { x: dx, y: dy, z: dz } = direction;
  let nearest = Infinity;
  let hit = -1, hitU = 0, hitV = 0;
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ax = positions[a], ay = positions[a + 1], az = positions[a + 2];
    const ux = positions[b] - ax, uy = positions[b + 1] - ay, uz = positions[b + 2] - az;
    const vx = positions[c] - ax, vy = positions[c + 1] - ay, vz = positions[c + 2] - az;
    const px = dy * vz - dz * vy, py = dz * vx - dx * vz, pz = dx * vy - dy * vx;
    const determinant = ux * px + uy * py + uz * pz;
    if (determinant < 1e-9) continue; // seen from behind, or edge on
    const sx = ox - ax, sy = oy - ay, sz = oz - az;
    const u = sx * px + sy * py + sz * pz;
    if (u < 0 || u > determinant) continue;
    const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
    const v = dx * qx + dy * qy + dz * qz;
    if (v < 0 || u + v > determinant) continue;
    const t = (vx * qx + vy * qy + vz * qz) / determinant;
    if (t > 0 && t < nearest) {
      nearest = t; hit = f; hitU = u / determinant; hitV = v / determinant;
    }
  }
  if (hit < 0) return null;
  const shares = [1 - hitU - hitV, hitU, hitV];
  return {
    face: hit / 3,
    distance: nearest,
    point: [ox + nearest * dx, oy + nearest * dy, oz + nearest * dz],
    corner: faces[hit + shares.indexOf(Math.max(...shares))],
  };
}
