// Seconds that a browser's loaders take for a file, and the bytes that its geometry takes in memory; the median of some.
//   node import.mjs FILE...      run from the folder that three lies in
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const require = createRequire(`${process.cwd()}/`);
const from = (path) => import(pathToFileURL(require.resolve(`three/examples/jsm/${path}`)));
const { OBJLoader } = await from('loaders/OBJLoader.js');
const { GLTFLoader } = await from('loaders/GLTFLoader.js');
const { MeshoptDecoder } = await from('libs/meshopt_decoder.module.js');
const TIMES = 5;

globalThis.self ??= globalThis; // the loaders expect a window
const gltf = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
const obj = new OBJLoader();

async function imported(path, bytes) {
  if (path.endsWith('.obj')) return obj.parse(bytes.toString());
  const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
  return (await gltf.parseAsync(buffer, '')).scene;
}

function costOf(scene) {
  const cost = { vertices: 0, triangles: 0, bytes: 0 };
  scene.traverse((node) => {
    if (!node.isMesh) return;
    const { attributes, index } = node.geometry;
    cost.vertices += attributes.position.count;
    cost.triangles += (index ?? attributes.position).count / 3;
    for (const each of [...Object.values(attributes), index]) cost.bytes += (each?.data ?? each)?.array.byteLength ?? 0;
  });
  return cost;
}

const answers = [];
for (const path of process.argv.slice(2)) {
  const bytes = await readFile(path);
  const seconds = [];
  let scene = null;
  for (let time = 0; time < TIMES; time += 1) {
    const began = performance.now();
    scene = await imported(path, bytes);
    seconds.push((performance.now() - began) / 1000);
  }
  answers.push({ seconds: seconds.sort((a, b) => a - b)[TIMES >> 1], ...costOf(scene) });
}
console.log(JSON.stringify(answers));
