#!/usr/bin/env bash
# Fetch Spark, which draws Gaussian splats, into services/web/vendor: from npm, minified, unmodified but for its import lines.
#   vendor-splats.sh VERSION        e.g. 2.2.0
set -euo pipefail
version=$1
vendor=$(cd "$(dirname "$0")/../services/web/vendor" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
stop() { echo "vendor-splats: $1" >&2; exit 1; }
three=$(basename "$(ls "$vendor"/three-*.module.js)" .module.js)
cd "$scratch"
npm pack --silent "@sparkjsdev/spark@$version" >/dev/null
tar xzf "sparkjsdev-spark-$version.tgz"
rm -f "$vendor"/spark-*
prefix=spark-$version
sed -E "s#from \"three\"#from \"./$three.module.js\"#g; s#from \"three/addons/postprocessing/Pass\.js\"#from \"./$three.pass.js\"#
  /^\/\/# sourceMappingURL=/d" package/dist/spark.module.min.js >"$vendor/$prefix.index.js"
grep -oE "from \"[^.\"][^\"]*\"" "$vendor/$prefix.index.js" && stop "these modules are not in services/web/vendor"
# Types for the TypeScript compiler of `make lint`: of what our pages use, as the package's own have it.
cat >"$vendor/$prefix.index.d.ts" <<'TYPES'
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
TYPES
# Our own modules name the version too.
sed -i -E "s#/spark-[0-9]+\.[0-9]+\.[0-9]+\.#/$prefix.#" "$vendor"/../*/*.js
# notice FILE TITLE PURL LICENCE: two lines that release/vendored.py reads, and behind them the licence.
notice() { { printf '%s\n%s\n\n' "$2" "$3"; cat "$4"; } >"$vendor/$prefix.$1"; }
notice LICENSE "Spark $version (MIT): index.js" "pkg:npm/%40sparkjsdev/spark@$version" package/LICENSE
# It holds fflate, as its package.json says.
fflate=$(sed -nE 's#.*"fflate": "\^([0-9.]+)".*#\1#p' package/package.json | head -1)
npm pack --silent "fflate@$fflate" >/dev/null
tar xzOf "fflate-$fflate.tgz" package/LICENSE >fflate.LICENSE
notice fflate.LICENSE "fflate $fflate (MIT): index.js" "pkg:npm/fflate@$fflate" fflate.LICENSE
