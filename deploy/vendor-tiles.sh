#!/usr/bin/env bash
# Fetch 3d-tiles-renderer, which draws scenes in tiles, into services/web/vendor: from npm, its own build for three.js, unmodified
# but for its import lines and the names of its files. Of its two files, each names those beside it.
#   vendor-tiles.sh VERSION        e.g. 0.5.3
set -euo pipefail
version=$1
vendor=$(cd "$(dirname "$0")/../services/web/vendor" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
stop() { echo "vendor-tiles: $1" >&2; exit 1; }
three=$(basename "$(ls "$vendor"/three-*.module.js)" .module.js)
cd "$scratch"
npm pack --silent "3d-tiles-renderer@$version" >/dev/null
tar xzf "3d-tiles-renderer-$version.tgz"
rm -f "$vendor"/tiles-renderer-*
prefix=tiles-renderer-$version
# The build's files have a hash in their names: the one that the package's index for three.js names, and the one that this names.
named() { sed -nE 's#.*from "\./(renderer-[A-Za-z0-9_-]+\.js)".*#\1#p' "package/build/$1" | grep -m 1 . || stop "$1 names no renderer-….js any more"; }
three_part=$(named index.three.js)
core_part=$(named "$three_part")
# put FILE NAME: copy one of them.
put() {
  sed -E "s#\"\./$core_part\"#\"./$prefix.core.js\"#; s#\"\./$three_part\"#\"./$prefix.three.js\"#; s#from \"three\"#from \"./$three.module.js\"#
    s#\"three/addons/loaders/GLTFLoader\.js\"#\"./$three.gltf-loader.js\"#; s#\"three/addons/utils/BufferGeometryUtils\.js\"#\"./$three.buffer-geometry-utils.js\"#
    /^\/\/# sourceMappingURL=/d" "package/build/$1" >"$vendor/$prefix.$2.js"
}
put "$core_part" core
put "$three_part" three
put index.three.js index
grep -hoE "from \"[^.\"][^\"]*\"" "$vendor/$prefix".*.js && stop "these modules are not in services/web/vendor"
# Types for the TypeScript compiler of `make lint`: of what our pages use, as the package's own have it.
cat >"$vendor/$prefix.index.d.ts" <<'TYPES'
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
TYPES
# Our own modules name the version too.
sed -i -E "s#/tiles-renderer-[0-9]+\.[0-9]+\.[0-9]+\.#/$prefix.#" "$vendor"/../*/*.js
{
  printf '%s\n%s\n\n' "3d-tiles-renderer $version (Apache-2.0): index.js three.js core.js" "pkg:npm/3d-tiles-renderer@$version"
  cat package/LICENSE
} >"$vendor/$prefix.LICENSE"
