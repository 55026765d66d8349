// Types of vendor/three-*.basis-transcoder.js, as far as ktx2-worker.js uses it: it comes without any. A script, so BASIS is global.

/** Creates the transcoder. `instantiateWasm` returns {} and calls `done` later. */
declare function BASIS(options: {
  instantiateWasm(
    imports: WebAssembly.Imports,
    done: (instance: WebAssembly.Instance, module: WebAssembly.Module) => void,
  ): object;
}): Promise<BasisTranscoder>;

interface BasisTranscoder {
  initializeBasis(): void;
  KTX2File: new (bytes: Uint8Array) => BasisKtx2File;
}

/** A KTX2 file. `format`: the number of a format that graphics cards know. */
interface BasisKtx2File {
  isValid(): boolean;
  startTranscoding(): boolean;
  getLevels(): number;
  getImageLevelInfo(level: number, layer: number, face: number): { origWidth: number; origHeight: number };
  getImageTranscodedSizeInBytes(level: number, layer: number, face: number, format: number): number;
  transcodeImage(
    target: Uint8Array,
    level: number,
    layer: number,
    face: number,
    format: number,
    flags: number,
    channel0: number,
    channel1: number,
  ): boolean | number;
  close(): void;
  delete(): void;
}
