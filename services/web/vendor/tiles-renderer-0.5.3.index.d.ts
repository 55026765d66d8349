import type { Camera, Group, LoadingManager, Object3D, WebGLRenderer } from 'three';

/** A tile of the tree. */
export interface Tile {
  parent: Tile | null;
  children: Tile[];
  geometricError: number;
}

/** Loads and shows the tiles that its cameras need. */
export class TilesRenderer {
  constructor(url: string);
  errorTarget: number;
  group: Group;
  manager: LoadingManager;
  root: Tile | null;
  visibleTiles: Set<Tile>;
  lruCache: { minBytesSize: number; maxBytesSize: number; cachedBytes: number };
  downloadQueue: { maxJobsPerOrigin: number };
  parseQueue: { maxJobs: number };
  addEventListener(kind: 'needs-update' | 'tiles-load-end' | 'load-root-tileset', listener: () => void): void;
  addEventListener(kind: 'tile-visibility-change', listener: (event: { scene: Object3D; tile: Tile; visible: boolean }) => void): void;
  addEventListener(kind: 'load-error', listener: (event: { tile: Tile | null; error: Error; url: string | URL }) => void): void;
  registerPlugin(plugin: { name: string; fetchData(url: string | URL): Promise<unknown> | null }): void;
  setCamera(camera: Camera): boolean;
  deleteCamera(camera: Camera): boolean;
  setResolution(camera: Camera, width: number, height: number): boolean;
  setResolutionFromRenderer(camera: Camera, renderer: WebGLRenderer): boolean;
  resetFailedTiles(): void;
  update(): void;
  dispose(): void;
}
