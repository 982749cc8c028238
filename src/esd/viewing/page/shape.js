// A shape on the stage: a scene of its own with a surface, a light, and a pattern carried by the map.

export const PATTERNS = ["none", "checker", "lines"];

export function makeShape(name) {
  const uniforms = { pattern: { value: 0 }, cell: { value: 0.07 } };
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide });
  material.onBeforeCompile = (shader) => addPattern(shader, uniforms);
  const mesh = new THREE.Mesh(new THREE.BufferGeometry(), material);
  mesh.raycast = THREE.acceleratedRaycast;
  mesh.frustumCulled = false;
  const light = new THREE.DirectionalLight(0xffffff, 1.9);
  const scene = new THREE.Scene();
  scene.add(mesh, light, light.target, new THREE.AmbientLight(0xffffff, 1.2));
  return { name, mesh, scene, light, uniforms, positions: new Float32Array(0), box: null };
}

// Fragments know their place on the target; edges of the pattern are as wide as a pixel.
function addPattern(shader, uniforms) {
  Object.assign(shader.uniforms, uniforms);
  shader.vertexShader = shader.vertexShader
    .replace("#include <common>", "#include <common>\nattribute vec4 place;\nvarying vec4 at;")
    .replace("#include <begin_vertex>", "#include <begin_vertex>\nat = place;");
  shader.fragmentShader = shader.fragmentShader
    .replace("#include <common>", "#include <common>\nvarying vec4 at;\nuniform int pattern;\nuniform float cell;")
    .replace("#include <color_fragment>", `#include <color_fragment>
      if (pattern == 1) {
        vec3 wave = sin(3.14159265 * at.xyz / cell);
        float side = wave.x * wave.y * wave.z;
        float width = max(fwidth(side), 1e-4);
        diffuseColor.rgb *= mix(1.0, mix(0.7, 1.08, smoothstep(-width, width, side)), at.w);
      } else if (pattern == 2) {
        vec3 turn = at.xyz / cell;
        vec3 away = abs(fract(turn - 0.5) - 0.5) / max(fwidth(turn), vec3(1e-4));
        float line = 1.0 - min(min(away.x, min(away.y, away.z)) / 1.6, 1.0);
        diffuseColor.rgb *= 1.0 - 0.75 * line * at.w;
      }`);
}

export function setSurface(shape, positions, faces) {
  shape.mesh.geometry.dispose();
  const geometry = (shape.mesh.geometry = new THREE.BufferGeometry());
  shape.positions = positions;
  geometry.setAttribute("position", new THREE.BufferAttribute(positions.slice(), 3));
  geometry.setIndex(new THREE.BufferAttribute(faces, 1));
  geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(positions.length), 3));
  const places = new Float32Array((positions.length / 3) * 4);
  geometry.setAttribute("place", new THREE.BufferAttribute(places, 4));
  geometry.computeVertexNormals();
}

// Move the vertices to `positions`, which `shape.positions` stay independent of.
export function move(shape, positions) {
  const { geometry } = shape.mesh;
  geometry.attributes.position.array.set(positions);
  geometry.attributes.position.needsUpdate = true;
  geometry.computeVertexNormals();
  geometry.boundsTree = undefined;
}

// The place on the target of each vertex, by `index` into `positions`; -1 for none.
export function setPlaces(shape, positions, index) {
  const places = shape.mesh.geometry.attributes.place;
  for (let i = 0; i < places.count; i++) {
    const t = index ? index[i] : i;
    if (t >= 0) places.setXYZW(i, positions[3 * t], positions[3 * t + 1], positions[3 * t + 2], 1);
    else places.setXYZW(i, 0, 0, 0, 0);
  }
  places.needsUpdate = true;
}

export function rotated(positions, matrix) {
  const result = new Float32Array(positions.length);
  for (let i = 0; i < positions.length; i += 3) {
    for (let row = 0; row < 3; row++) {
      let sum = 0;
      for (let k = 0; k < 3; k++) sum += matrix[3 * row + k] * positions[i + k];
      result[i + row] = sum;
    }
  }
  return result;
}

export const count = (shape) => shape.positions.length / 3;

export function vertexAt(shape, i) {
  const point = new THREE.Vector3().fromBufferAttribute(shape.mesh.geometry.attributes.position, i);
  return point.add(shape.mesh.position);
}

export function normalAt(shape, i) {
  return new THREE.Vector3().fromBufferAttribute(shape.mesh.geometry.attributes.normal, i);
}

// The vertex nearest to where a ray first meets the surface; null where it misses.
export function hitVertex(shape, ray) {
  const [hit] = intersections(shape, ray);
  if (!hit) return null;
  const corners = [hit.face.a, hit.face.b, hit.face.c];
  const reach = corners.map((i) => vertexAt(shape, i).distanceToSquared(hit.point));
  return corners[reach.indexOf(Math.min(...reach))];
}

export function isHidden(shape, i, camera) {
  const point = vertexAt(shape, i);
  const toward = camera.position.clone().sub(point);
  const far = toward.length();
  const ray = new THREE.Raycaster(camera.position, toward.multiplyScalar(-1 / far), 0, far - 0.01);
  return intersections(shape, ray).length > 0;
}

export function facesViewer(shape, i, camera) {
  return normalAt(shape, i).dot(camera.position.clone().sub(vertexAt(shape, i))) > 0;
}

function intersections(shape, ray) {
  const { geometry } = shape.mesh;
  if (!geometry.index?.count) return [];
  geometry.boundsTree ??= new THREE.MeshBVH(geometry, { indirect: true });
  shape.mesh.updateMatrixWorld();
  ray.firstHitOnly = true;
  return ray.intersectObject(shape.mesh);
}
