// The parts of three.js that the viewer uses, as one global object.
export {
  AmbientLight,
  BufferAttribute,
  BufferGeometry,
  ColorManagement,
  DirectionalLight,
  DoubleSide,
  LinearSRGBColorSpace,
  Mesh,
  MeshLambertMaterial,
  PerspectiveCamera,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
export { TrackballControls } from "three/examples/jsm/controls/TrackballControls.js";
export { acceleratedRaycast, MeshBVH } from "three-mesh-bvh";
