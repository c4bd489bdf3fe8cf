// The page of a depth map: a mesh or points, a grid in metres, depth at the pointer, distances.
import * as THREE from "three";
import { OrbitControls } from "orbit";

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const PICK_PX = 7;
const CLICK_PX = 4; // the pointer moves less in a click
const KEY_TURN = Math.PI / 36;
const KEY_ZOOM = 1.1;

function bytesOf(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
}

async function inflated(base64) {
  const stream = new Blob([bytesOf(base64)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Planes of the high bytes, the low bytes and the links; steps are differences to the row above.
async function readGrid() {
  const { width, height, nearest_m: nearest, log_step: logStep } = data;
  const count = width * height;
  const planes = await inflated(data.grid);
  const steps = new Uint16Array(count);
  const depth = new Float32Array(count); // 0 where there is none
  for (let i = 0; i < count; i++) {
    steps[i] = (planes[i] << 8) + planes[count + i] + (i < width ? 0 : steps[i - width]);
    depth[i] = steps[i] ? nearest * Math.exp((steps[i] - 1) * logStep) : 0;
  }
  const errors = data.error ? await inflated(data.error) : null; // in percent of depth
  return { depth, errors, links: planes.subarray(2 * count) };
}

// x right, y up, z backwards, as in OpenGL.
function positionsOf(depth) {
  const { width, height, stride, focal_px: [fx, fy], centre_px: [cx, cy], size_px: size } = data;
  const xyz = new Float32Array(3 * depth.length);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      let ray = [(x * stride - cx) / fx, -(y * stride - cy) / fy, -1];
      if (data.is_panorama) {
        const longitude = ((x * stride + 0.5) / size[0] - 0.5) * 2 * Math.PI;
        const latitude = (0.5 - (y * stride + 0.5) / size[1]) * Math.PI;
        const across = Math.cos(latitude);
        ray = [across * Math.sin(longitude), Math.sin(latitude), -across * Math.cos(longitude)];
      }
      for (let axis = 0; axis < 3; axis++) xyz[3 * i + axis] = ray[axis] * depth[i];
    }
  }
  return xyz;
}

// Bit 0 links a point to its right neighbour, bit 1 to the one below.
function facesOf(links) {
  const { width, height } = data;
  const faces = [];
  for (let y = 0; y + 1 < height; y++) {
    for (let x = 0; x + 1 < width; x++) {
      const a = y * width + x;
      const [b, c, d] = [a + 1, a + width, a + width + 1];
      if ((links[a] & 3) === 3) faces.push(a, c, b);
      if (links[c] & 1 && links[b] & 2) faces.push(b, c, d);
    }
  }
  return faces;
}

async function coloursOf() {
  const image = new Image();
  image.src = `data:image/jpeg;base64,${data.image}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [data.width, data.height];
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0, data.width, data.height);
  return context.getImageData(0, 0, data.width, data.height).data;
}

function quantile(values, share) {
  return Float32Array.from(values).sort()[Math.floor(share * (values.length - 1))];
}

THREE.ColorManagement.enabled = false;
const { depth, errors, links } = await readGrid();
const xyz = positionsOf(depth);
const known = Array.from(depth.keys()).filter((i) => depth[i] > 0);
const far = quantile(known.map((i) => depth[i]), 0.95);
const middle = quantile(known.map((i) => depth[i]), 0.5);

const renderer = new THREE.WebGLRenderer({ canvas: $("view"), antialias: true });
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
const scene = new THREE.Scene();
scene.background = new THREE.Color(0x16181c);
const camera = new THREE.PerspectiveCamera(50, 1, far / 1000, far * 100);
const controls = new OrbitControls(camera, renderer.domElement);

const shape = new THREE.BufferGeometry();
shape.setAttribute("position", new THREE.BufferAttribute(xyz, 3));
shape.setAttribute("color", new THREE.BufferAttribute(new Uint8Array(await coloursOf()), 4, true));
const cloudShape = shape.clone().setIndex(known);
shape.setIndex(facesOf(links));
const mesh = new THREE.Mesh(shape, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide }));
const cloud = new THREE.Points(cloudShape, new THREE.PointsMaterial({ vertexColors: true, size: 2, sizeAttenuation: false }));
mesh.frustumCulled = cloud.frustumCulled = false;
cloud.visible = false;
scene.add(mesh, cloud);

function addGrid() {
  const cell = 10 ** Math.floor(Math.log10(far / 1.5));
  const lowest = quantile(known.map((i) => xyz[3 * i + 1]), 0.01);
  const cells = 2 * Math.ceil(far / cell);
  const grid = new THREE.GridHelper(cells * cell, cells, 0x8090a8, 0x4a5566);
  grid.position.y = lowest;
  scene.add(grid);
  $("cell").textContent = `cells of ${cell >= 1 ? cell : cell.toPrecision(1)} m`;
  return grid;
}
const grid = addGrid();

const marks = new THREE.BufferGeometry();
const onTop = { color: 0xffd54a, depthTest: false };
scene.add(new THREE.Line(marks, new THREE.LineBasicMaterial(onTop)));
scene.add(new THREE.Points(marks, new THREE.PointsMaterial({ ...onTop, size: 9, sizeAttenuation: false })));
let picked = [];

function reset() {
  const turn = data.is_panorama ? 0 : 0.2; // radians, so that one sees that it is no photograph
  controls.target.set(0, 0, data.is_panorama ? -0.01 * far : -middle);
  camera.position.set(Math.sin(turn) * middle, 0.5 * Math.sin(turn) * middle, (Math.cos(turn) - 1) * middle);
  controls.update();
}

function resize() {
  const { clientWidth: width, clientHeight: height } = renderer.domElement;
  renderer.setSize(width, height, false);
  camera.aspect = width / height;
  const [tanX, tanY] = [data.size_px[0] / 2 / data.focal_px[0], data.size_px[1] / 2 / data.focal_px[1]];
  const tan = data.is_panorama ? 0.7 : 1.3 * // clear of the bars above and below
    Math.max(tanY, tanX / camera.aspect);
  camera.fov = Math.min(120, (2 * Math.atan(tan) * 180) / Math.PI);
  camera.updateProjectionMatrix();
  draw();
}

function draw() {
  renderer.render(scene, camera);
}

// The point at the pointer, -1 without one: of those drawn close to it, one that hides others.
function pointAt(event) {
  const box = renderer.domElement.getBoundingClientRect();
  const [wantedX, wantedY] = [event.clientX - box.left, event.clientY - box.top];
  camera.updateMatrixWorld();
  const m = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
  let [found, nearest] = [-1, Infinity];
  for (const i of known) {
    const [x, y, z] = [xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]];
    const w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0 || w >= nearest) continue;
    const screenX = ((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) * box.width / 2;
    const screenY = (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) * box.height / 2;
    const away = Math.hypot(screenX - wantedX, screenY - wantedY);
    const score = w * (1 + away / 100); // on one surface, the closest to the pointer
    if (away < PICK_PX && score < nearest) [found, nearest] = [i, score];
  }
  return found;
}

function showDepth(event) {
  const i = pointAt(event);
  const [x, y] = [(i % data.width) * data.stride, Math.floor(i / data.width) * data.stride];
  const error = i < 0 || !errors ? "" : ` ± ${((errors[i] * depth[i]) / 100).toFixed(2)} m`;
  $("depth").textContent = i < 0 ? "no depth here" : `${depth[i].toFixed(3)} m${error} at pixel ${x}, ${y}`;
}

function pick(event) {
  const i = pointAt(event);
  showDepth(event);
  if (i < 0) return;
  if (picked.length === 2) picked = [];
  picked.push(new THREE.Vector3().fromArray(xyz, 3 * i));
  marks.setFromPoints([picked[0], picked[picked.length - 1]]);
  marks.computeBoundingSphere();
  $("distance").textContent =
    picked.length === 2 ? `distance ${picked[0].distanceTo(picked[1]).toFixed(3)} m` : "click a second point";
  draw();
}

function toggle(id, shown) {
  $(id).setAttribute("aria-pressed", String(shown));
  draw();
}

// Angles in radians; a zoom above 1 is nearer.
function orbit(right, up, zoom = 1) {
  const offset = new THREE.Spherical().setFromVector3(camera.position.clone().sub(controls.target));
  offset.set(offset.radius / zoom, offset.phi - up, offset.theta + right).makeSafe();
  camera.position.setFromSpherical(offset).add(controls.target);
  controls.update();
  draw();
}

const actions = {
  reset: () => { reset(); draw(); },
  points: () => { cloud.visible = !cloud.visible; mesh.visible = !cloud.visible; toggle("points", cloud.visible); },
  grid: () => { grid.visible = !grid.visible; toggle("grid", grid.visible); },
  keys: () => { $("list").hidden = !$("list").hidden; toggle("keys", !$("list").hidden); },
};
const byKey = {
  r: actions.reset,
  p: actions.points,
  g: actions.grid,
  "?": actions.keys,
  arrowleft: () => orbit(-KEY_TURN, 0),
  arrowright: () => orbit(KEY_TURN, 0),
  arrowup: () => orbit(0, KEY_TURN),
  arrowdown: () => orbit(0, -KEY_TURN),
  "+": () => orbit(0, 0, KEY_ZOOM),
  "=": () => orbit(0, 0, KEY_ZOOM), // + without Shift
  "-": () => orbit(0, 0, 1 / KEY_ZOOM),
};
for (const [id, act] of Object.entries(actions)) $(id).addEventListener("click", act);
addEventListener("keydown", (event) => {
  const act = byKey[event.key.toLowerCase()];
  if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  act();
});

let pressed = null;
let waiting = null;
const view = renderer.domElement;
view.addEventListener("pointerdown", (event) => { pressed = event; });
view.addEventListener("pointerup", (event) => {
  const moved = pressed ? Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) : Infinity;
  if (moved < CLICK_PX && event.button === 0) pick(event);
  pressed = null;
});
view.addEventListener("pointermove", (event) => {
  if (event.buttons) return;
  if (!waiting) requestAnimationFrame(() => { showDepth(waiting); waiting = null; });
  waiting = event;
});
controls.addEventListener("change", draw);
new ResizeObserver(resize).observe(view);
reset();
resize();
$("depth").textContent = `${known.length.toLocaleString("en")} points`;
document.body.dataset.points = known.length;
