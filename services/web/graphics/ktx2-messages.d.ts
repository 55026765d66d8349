// Messages between ktx2.js and its workers.

/** To a worker: the compiled transcoder first, then pictures. `format`: the transcoder's number of a format of graphics cards. */
export type Ktx2Request = { module: WebAssembly.Module } | { picture: ArrayBuffer; format: number };

/** A level of detail of a picture (mipmap). */
export interface Mipmap {
  data: Uint8Array<ArrayBuffer>;
  width: number;
  height: number;
}

/** From a worker: the levels of a picture, the largest first, or why there are none. */
export type Ktx2Answer = { levels: Mipmap[] } | { error: string };
