// What Babylon.js reads of the files named on the command line, as one JSON array: {triangles, colours, low, high} or {fault}.
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { fileURLToPath, pathToFileURL } from 'node:url';

const installed = createRequire(`${process.cwd()}/`); // the packages lie in the folder this script is run from

/** Loads files of this machine, for which Babylon.js has no other way in node. */
globalThis.XMLHttpRequest = class {
  status = 0;
  readyState = 1;
  #listeners = [];
  open(method, url) {
    this.url = this.responseURL = url;
  }
  addEventListener(name, listener) {
    this.#listeners.push([name, listener]);
  }
  removeEventListener(name, listener) {
    this.#listeners = this.#listeners.filter(([, each]) => each !== listener);
  }
  setRequestHeader() {}
  getResponseHeader() {
    return null;
  }
  abort() {}
  send() {
    queueMicrotask(() => {
      try {
        const bytes = readFileSync(fileURLToPath(this.url));
        this.status = 200;
        this.response = this.responseType === 'arraybuffer' ? new Uint8Array(bytes).buffer : bytes.toString();
        this.responseText = this.response;
      } catch (error) {
        this.status = 404;
        this.statusText = String(error);
      }
      this.readyState = 4;
      for (const name of ['readystatechange', 'load', 'loadend']) {
        for (const [listened, listener] of this.#listeners) if (listened === name) listener({});
      }
    });
  }
};

console.log = console.warn = console.error; // standard output is for the answer
const BABYLON = installed('babylonjs');
installed('babylonjs-loaders');
const { MeshoptDecoder } = installed('meshoptimizer');
globalThis.MeshoptDecoder = { ...MeshoptDecoder, useWorkers() {} };
BABYLON.Tools.LoadBabylonScriptAsync = async () => {}; // the decoder is here already; it would come from another host

async function read(path) {
  const scene = new BABYLON.Scene(new BABYLON.NullEngine());
  const { meshes, textures } = await BABYLON.LoadAssetContainerAsync(pathToFileURL(path).href, scene);
  const drawn = meshes.filter((mesh) => mesh.getTotalVertices() > 0);
  const coloured = drawn.some((mesh) => mesh.isVerticesDataPresent(BABYLON.VertexBuffer.ColorKind));
  for (const mesh of meshes) mesh.computeWorldMatrix(true);
  const boxes = drawn.map((mesh) => mesh.refreshBoundingInfo({}).getBoundingInfo().boundingBox);
  const extreme = (pick, which) => ['x', 'y', 'z'].map((axis) => pick(...boxes.map((box) => box[which][axis])));
  return {
    triangles: drawn.reduce((sum, mesh) => sum + mesh.getTotalIndices() / 3, 0),
    colours: textures.length ? 'texture' : coloured ? 'vertices' : 'none',
    low: extreme(Math.min, 'minimumWorld'),
    high: extreme(Math.max, 'maximumWorld'),
  };
}

await MeshoptDecoder.ready;
const readings = [];
for (const path of process.argv.slice(2)) {
  readings.push(await read(path).catch((error) => ({ fault: String(error).slice(0, 200) })));
}
process.stdout.write(`${JSON.stringify(readings)}\n`, () => process.exit(0));
