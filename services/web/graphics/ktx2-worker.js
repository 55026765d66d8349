// Beside the page: KTX2 pictures into blocks that a graphics card knows, with all their mips. Basis Universal's wrapper makes functions
// out of text, which the page's security policy forbids; this file comes with a policy of its own, which allows just that.
importScripts('../vendor/three-0.187.0.basis-transcoder.js');

let basis = null;

// {module}, a compiled WebAssembly.Module, comes first; then {picture, kind}: a file, and a format by the transcoder's number.
onmessage = async ({ data: { module, picture, kind }, ports: [back] }) => {
  try {
    if (module) basis = await begun(module);
    const levels = picture ? unpacked(picture, kind) : [];
    back.postMessage({ levels }, levels.map(({ data }) => data.buffer));
  } catch (error) {
    back.postMessage({ error: String(error?.message ?? error) });
  }
};

async function begun(module) {
  const made = await BASIS({
    instantiateWasm(imports, done) {
      WebAssembly.instantiate(module, imports).then((instance) => done(instance, module));
      return {}; // it comes later
    },
  });
  made.initializeBasis();
  return made;
}

/** [{data, width, height}], the largest first. */
function unpacked(picture, kind) {
  const file = new basis.KTX2File(new Uint8Array(picture));
  try {
    if (!file.isValid() || !file.startTranscoding()) throw new Error('A picture cannot be unpacked.');
    return Array.from({ length: file.getLevels() }, (_, level) => {
      const { origWidth: width, origHeight: height } = file.getImageLevelInfo(level, 0, 0);
      const data = new Uint8Array(file.getImageTranscodedSizeInBytes(level, 0, 0, kind));
      if (!file.transcodeImage(data, level, 0, 0, kind, 0, -1, -1)) throw new Error('A picture cannot be unpacked.');
      return { data, width, height };
    });
  } finally {
    file.close();
    file.delete();
  }
}
