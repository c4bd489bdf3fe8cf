// Depth of a photo in the browser, the same as that of `depthcli predict --upsample bilinear`.
//
// Left out: guided upsampling (sharper edges), padding of photos longer than 2:1, and the focal
// length in EXIF: enter the field of view instead.
import * as ort from "./node_modules/onnxruntime-web/dist/ort.wasm.min.mjs";

const $ = (id) => document.getElementById(id);
ort.env.wasm.numThreads = 1; // more need a server that isolates the page from other origins

async function loadModel(folder) {
  const card = await (await fetch(`${folder}/card.json`)).json();
  return { card, session: await ort.InferenceSession.create(`${folder}/${card.file}`) };
}

// The old pixels of which each new one is a weighted mean, along one axis: all that it covers where
// an image shrinks, else the two next to it, with half-pixel centres.
function weightsOf(from, to, isArea) {
  const step = from / to;
  return Array.from({ length: to }, (_, i) => {
    if (isArea && step > 1) {
      const [start, end] = [i * step, Math.min((i + 1) * step, from)];
      const first = Math.floor(start);
      const count = Math.ceil(end) - first;
      const overlap = (px) => (Math.min(px + 1, end) - Math.max(px, start)) / step;
      return { first, weights: Array.from({ length: count }, (_, k) => overlap(first + k)) };
    }
    const place = Math.min(Math.max((i + 0.5) * step - 0.5, 0), from - 1);
    const first = Math.floor(place);
    const share = place - first;
    return { first, weights: share ? [1 - share, share] : [1] };
  });
}

function resize({ values, width, height }, newWidth, newHeight, { isArea = false } = {}) {
  const narrow = new Float32Array(newWidth * height);
  for (const [x, { first, weights }] of weightsOf(width, newWidth, isArea).entries())
    for (let y = 0; y < height; y++)
      for (let k = 0; k < weights.length; k++)
        narrow[y * newWidth + x] += weights[k] * values[y * width + first + k];
  const resized = new Float32Array(newWidth * newHeight);
  for (const [y, { first, weights }] of weightsOf(height, newHeight, isArea).entries())
    for (let k = 0; k < weights.length; k++)
      for (let x = 0; x < newWidth; x++)
        resized[y * newWidth + x] += weights[k] * narrow[(first + k) * newWidth + x];
  return { values: resized, width: newWidth, height: newHeight };
}

// V of HSV: the largest of red, green and blue, from 0 to 1.
function valueChannel({ data, width, height }) {
  const values = new Float32Array(width * height);
  for (let i = 0; i < values.length; i++)
    values[i] = Math.max(data[4 * i], data[4 * i + 1], data[4 * i + 2]) / 255;
  return { values, width, height };
}

// The aspect of the photo at the number of pixels that the network was trained with.
function inputSize({ width, height, multiple_of: step }, photo) {
  const [area, aspect] = [width * height, photo.width / photo.height];
  const side = (px) => Math.max(step, Math.round(px / step) * step);
  return [side(Math.sqrt(area * aspect)), side(Math.sqrt(area / aspect))];
}

// The focal length over that of the training camera, both in pixels of the network's input. Without
// a field of view, the photo is taken for the largest crop of the training camera's images.
function focalRatio({ input, camera }, photo, [inputWidth, inputHeight], hfovDeg) {
  const focalPx = (deg, width) => width / 2 / Math.tan((deg * Math.PI) / 360);
  const trainedPx = focalPx(camera.hfov_deg, input.width);
  const [longest, shortest] = [Math.max, Math.min].map(
    (end) => end(photo.width, photo.height) / end(input.width, input.height));
  const px = hfovDeg ? focalPx(hfovDeg, photo.width) : trainedPx * Math.max(longest, shortest);
  return (px * Math.sqrt((inputWidth / photo.width) * (inputHeight / photo.height))) / trainedPx;
}

// Metres at every pixel of an ImageData.
async function estimateDepth({ card, session }, photo, hfovDeg) {
  const { input, output, camera } = card;
  const [width, height] = inputSize(input, photo);
  const gray = resize(valueChannel(photo), width, height, { isArea: true }).values;
  const normalized = gray.map((value) => (value - input.mean[0]) / input.std[0]);
  const tensor = new ort.Tensor("float32", normalized, [1, 1, height, width]);
  const results = await session.run({ [session.inputNames[0]]: tensor });
  const { data, dims } = results[session.outputNames[0]];
  const coarse = data.map((raw) => Math.exp(output.scale * raw + output.shift));
  const [rows, columns] = dims.slice(-2);
  const full = resize({ values: coarse, width: columns, height: rows }, photo.width, photo.height);
  const factor = focalRatio(card, photo, [width, height], hfovDeg) ** camera.exponent;
  return full.values.map((m) => Math.min(Math.max(m, output.min_m), output.max_m) * factor);
}

// Inferno of 1/depth: near is bright.
const COLOURS = [[0, 0, 4], [40, 11, 84], [101, 21, 110], [159, 42, 99], [212, 72, 66],
  [245, 125, 21], [250, 193, 39], [252, 255, 164], [252, 255, 164]];

function coloured(depth, width, height) {
  const sorted = Float32Array.from(depth).sort();
  const [near, far] = [0.02, 0.98].map((share) => 1 / sorted[Math.floor(share * sorted.length)]);
  const image = new ImageData(width, height);
  for (let i = 0; i < depth.length; i++) {
    const share = Math.min(Math.max((1 / depth[i] - far) / (near - far || 1), 0), 1);
    const place = share * (COLOURS.length - 2);
    const [low, high] = [COLOURS[Math.floor(place)], COLOURS[Math.floor(place) + 1]];
    const colour = low.map((level, c) => level + (place % 1) * (high[c] - level));
    image.data.set([...colour, 255], 4 * i);
  }
  return image;
}

const say = (text) => { $("status").textContent = text; };
addEventListener("error", ({ message }) => say(message));
addEventListener("unhandledrejection", ({ reason }) => say(reason.message || String(reason)));

const model = await loadModel("model");
let photo = null;
let depth = null;
say(`${model.card.name} ${model.card.version} is ready.`);

async function open(file) {
  const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none" }).catch(() => {
    throw new Error(`${file.name} is no image that this browser can read`);
  });
  [$("photo").width, $("photo").height] = [bitmap.width, bitmap.height];
  const context = $("photo").getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  photo = context.getImageData(0, 0, bitmap.width, bitmap.height);
  await estimate();
}

async function estimate() {
  if (!photo || !$("hfov").checkValidity()) return;
  const started = performance.now();
  depth = await estimateDepth(model, photo, Number($("hfov").value));
  const { width, height } = photo;
  [$("depth").width, $("depth").height] = [width, height];
  $("depth").getContext("2d").putImageData(coloured(depth, width, height), 0, 0);
  const rows = Array.from({ length: height }, (_, y) => depth.subarray(y * width, (y + 1) * width));
  URL.revokeObjectURL($("save").href);
  $("save").href = URL.createObjectURL(new Blob([`Pf\n${width} ${height}\n-1.0\n`, ...rows.reverse()]));
  $("save").hidden = false;
  say(`${Math.round(performance.now() - started)} ms. Point at a place to see its metres.`);
}

function showMetres({ target, offsetX, offsetY }) {
  const x = Math.floor((offsetX / target.clientWidth) * photo.width);
  const y = Math.floor((offsetY / target.clientHeight) * photo.height);
  const metres = depth[y * photo.width + x];
  if (metres) say(`${metres.toFixed(3)} m at pixel ${x}, ${y}`);
}

for (const id of ["photo", "depth"]) $(id).addEventListener("pointermove", showMetres);
$("file").addEventListener("change", ({ target }) => target.files.length && open(target.files[0]));
$("hfov").addEventListener("change", estimate);
addEventListener("dragover", (event) => { event.preventDefault(); document.body.className = "dropping"; });
addEventListener("dragleave", () => { document.body.className = ""; });
addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.className = "";
  if (event.dataTransfer.files.length) open(event.dataTransfer.files[0]);
});
