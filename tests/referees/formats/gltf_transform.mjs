// What glTF-Transform reads of the files named on the command line, as one JSON array: {triangles, colours, low, high} or {fault}.
import { createRequire } from 'node:module';

const installed = createRequire(`${process.cwd()}/`); // the packages lie in the folder this script is run from
const { NodeIO, getBounds } = installed('@gltf-transform/core');
const { ALL_EXTENSIONS } = installed('@gltf-transform/extensions');
const { MeshoptDecoder } = installed('meshoptimizer');

await MeshoptDecoder.ready;
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({ 'meshopt.decoder': MeshoptDecoder });

async function read(path) {
  const root = (await io.read(path)).getRoot();
  const primitives = root.listMeshes().flatMap((mesh) => mesh.listPrimitives());
  const { min, max } = getBounds(root.listScenes()[0]);
  return {
    triangles: primitives.reduce((sum, primitive) => sum + primitive.getIndices().getCount() / 3, 0),
    colours: root.listTextures().length
      ? 'texture'
      : primitives.some((each) => each.getAttribute('COLOR_0'))
        ? 'vertices'
        : 'none',
    low: min,
    high: max,
  };
}

const readings = [];
for (const path of process.argv.slice(2)) {
  readings.push(await read(path).catch((error) => ({ fault: String(error).slice(0, 200) })));
}
console.log(JSON.stringify(readings));
