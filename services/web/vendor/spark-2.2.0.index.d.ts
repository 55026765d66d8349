import type { Object3D, WebGLRenderer } from 'three';

/** Gaussian splats of one file. */
export class SplatMesh extends Object3D {
  constructor(options: { fileBytes: Uint8Array | ArrayBuffer; fileName: string });
  initialized: Promise<SplatMesh>;
  dispose(): void;
}

/** Sorts and draws all splats of a scene that it is in. */
export class SparkRenderer extends Object3D {
  constructor(options: { renderer: WebGLRenderer; onDirty?: () => void; preBlurAmount?: number; blurAmount?: number });
  dispose(): void;
}
