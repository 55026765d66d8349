#!/usr/bin/env bash
# Fetch the browser libraries of services/web/vendor at one version, from npm, unmodified but for their import lines:
# there is no bundler and no import map, so a module names the file beside it.
#   vendor-web.sh VERSION        e.g. 0.187.0
set -euo pipefail
version=$1
vendor=$(cd "$(dirname "$0")/../services/web/vendor" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$scratch"
npm pack --silent "three@$version" >/dev/null
tar xzf "three-$version.tgz"
rm -f "$vendor"/three-*
name() { echo "three-$version.$1.js"; }
copy() { cp "package/$1" "$vendor/$(name "$2")"; }
copy build/three.core.js core
copy build/three.module.js module
copy examples/jsm/loaders/GLTFLoader.js gltf-loader
copy examples/jsm/controls/OrbitControls.js orbit-controls
copy examples/jsm/utils/BufferGeometryUtils.js buffer-geometry-utils
copy examples/jsm/utils/SkeletonUtils.js skeleton-utils
copy examples/jsm/libs/meshopt_decoder.module.js meshopt-decoder
# What unpacks KTX2, which only pages that meet such a file load: Binomial's, under the Apache licence.
copy examples/jsm/libs/basis/basis_transcoder.js basis-transcoder
cp package/examples/jsm/libs/basis/basis_transcoder.wasm "$vendor/three-$version.basis-transcoder.wasm"
sed -i -E "s#(from|import) '(\./three\.core\.js)'#\1 './$(name core)'#; s#from 'three'#from './$(name module)'#
  s#'\.\./utils/BufferGeometryUtils\.js'#'./$(name buffer-geometry-utils)'#; s#'\.\./utils/SkeletonUtils\.js'#'./$(name skeleton-utils)'#" \
  "$vendor"/three-"$version".*.js
# Our own modules name the version too.
sed -i -E "s#/three-[0-9]+\.[0-9]+\.[0-9]+\.#/three-$version.#" "$vendor"/../*/*.js
cp package/LICENSE "$vendor/three-$version.LICENSE"
# Types for the TypeScript compiler of `make lint`, which looks for a module's types beside it: those of npm's @types/three.
types() { echo "export * from '$2';" >"$vendor/three-$version.$1.d.ts"; }
types module three
types orbit-controls three/addons/controls/OrbitControls.js
types gltf-loader three/addons/loaders/GLTFLoader.js
types meshopt-decoder three/addons/libs/meshopt_decoder.module.js
{
  cat <<'NOTICE'
three-*.basis-transcoder.js and .wasm, and what is in them:

Basis Universal™ Supercompressed GPU Texture Compression Library
Copyright © 2016–2026 Binomial LLC. All rights reserved except as granted under the Apache 2.0 license.
"Basis Universal" is a trademark of Binomial LLC.

NOTICE
  sed '/END OF TERMS AND CONDITIONS/q' "$vendor/../../../LICENSE"
} >"$vendor/three-$version.basis-transcoder.LICENSE"
echo "vendor-web: now set @types/three in package.json to the version nearest to $version, and run
  npm install --omit-lockfile-registry-resolved" >&2
