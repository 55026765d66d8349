#!/usr/bin/env bash
# Fetch the browser libraries of services/web/vendor at one version, from npm. Their import lines are changed, because there
# is no bundler and no import map: a module names the file beside it. three.js comes without a minified build and is
# minified here: half the bytes to send, a third to parse. Every library, and every other one inside its files, gets a
# notice of its licence, from which the SBOM is made.
#   vendor-web.sh VERSION        e.g. 0.187.0
set -euo pipefail
version=$1
esbuild=0.28.2
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
copy examples/jsm/postprocessing/Pass.js pass
copy examples/jsm/utils/SkeletonUtils.js skeleton-utils
copy examples/jsm/libs/meshopt_decoder.module.js meshopt-decoder
# What unpacks KTX2, which only pages that meet such a file load: Binomial's, under the Apache licence.
copy examples/jsm/libs/basis/basis_transcoder.js basis-transcoder
cp package/examples/jsm/libs/basis/basis_transcoder.wasm "$vendor/three-$version.basis-transcoder.wasm"
sed -i -E "s#(from|import) '(\./three\.core\.js)'#\1 './$(name core)'#; s#from 'three'#from './$(name module)'#
  s#'\.\./utils/BufferGeometryUtils\.js'#'./$(name buffer-geometry-utils)'#; s#'\.\./utils/SkeletonUtils\.js'#'./$(name skeleton-utils)'#" \
  "$vendor"/three-"$version".*.js
# The Basis transcoder is minified as it comes.
npm install --silent --no-save --prefix minify "esbuild@$esbuild" >/dev/null
for file in "$vendor"/three-"$version".*.js; do
  [ "$file" = "$vendor/$(name basis-transcoder)" ] ||
    minify/node_modules/.bin/esbuild "$file" --minify --legal-comments=inline --format=esm --target=es2022 --log-level=warning \
      --allow-overwrite --outfile="$file"
done
# Our own modules name the version too.
sed -i -E "s#/three-[0-9]+\.[0-9]+\.[0-9]+\.#/three-$version.#" "$vendor"/../*/*.js
# Types for the TypeScript compiler of `make lint`, which looks for a module's types beside it: those of npm's @types/three.
types() { echo "export * from '$2';" >"$vendor/three-$version.$1.d.ts"; }
types module three
types orbit-controls three/addons/controls/OrbitControls.js
types gltf-loader three/addons/loaders/GLTFLoader.js
types meshopt-decoder three/addons/libs/meshopt_decoder.module.js
stop() { echo "vendor-web: $1" >&2; exit 1; }
# notice FILE TITLE PURL LICENCE_TEXT...: two lines that release/vendored.py reads, "NAME VERSION (LICENCE): FILES" and the
# package URL, by which audits know the library; behind them the licence.
notice() {
  local to="$vendor/three-$version.$1" title=$2 purl=$3
  shift 3
  { printf '%s\n%s\n\n' "$title" "$purl"; cat "$@"; } >"$to"
}
# found WORDS FILE: the version that stands behind these words in a file of the package.
found() { sed -nE "s#.*$1 ([0-9]+(\.[0-9]+)+).*#\1#p" "package/$2" | grep -m 1 . || stop "$2 no longer says: $1 …"; }
# licence PACKAGE@VERSION: the licence's text of another npm package.
licence() { npm pack --silent "$1" >/dev/null && tar xzOf "${1/@/-}.tgz" --wildcards 'package/LICENSE*'; }
notice LICENSE "three.js $version (MIT): core.js module.js gltf-loader.js orbit-controls.js buffer-geometry-utils.js skeleton-utils.js pass.js" \
  "pkg:npm/three@$version" package/LICENSE
earcut=$(found "mapbox/earcut version" src/extras/lib/earcut.js)
licence "earcut@$earcut" | notice earcut.LICENSE "earcut $earcut (ISC): core.js" "pkg:npm/earcut@$earcut"
meshopt=$(found meshoptimizer examples/jsm/libs/meshopt_decoder.module.js)
licence "meshoptimizer@$meshopt.0" |
  notice meshopt-decoder.LICENSE "meshoptimizer $meshopt (MIT): meshopt-decoder.js" "pkg:npm/meshoptimizer@$meshopt.0"
# The transcoder does not say its version. These bytes stand in Binomial's repository at the tag v1_50_0, built with zstd 1.4.9.
basis=6cf17dc889352c42e9acf8897107978d127005fe3386c36a0e3845e27967630a
sha256sum --check --status <<<"$basis  package/examples/jsm/libs/basis/basis_transcoder.wasm" ||
  stop "the Basis transcoder is another one: look up its version, and write that and its sha256 into this script"
{
  cat <<'NOTICE'
Basis Universal™ Supercompressed GPU Texture Compression Library
Copyright © 2016–2026 Binomial LLC. All rights reserved except as granted under the Apache 2.0 license.
"Basis Universal" is a trademark of Binomial LLC.

NOTICE
  sed '/END OF TERMS AND CONDITIONS/q' "$vendor/../../../LICENSE"
} | notice basis-transcoder.LICENSE "Basis Universal 1.50 (Apache-2.0): basis-transcoder.js basis-transcoder.wasm" \
  "pkg:github/binomialllc/basis_universal@v1_50_0"
notice zstd.LICENSE "Zstandard 1.4.9 (BSD-3-Clause): basis-transcoder.wasm" "pkg:github/facebook/zstd@v1.4.9" <<'NOTICE'
BSD License

For Zstandard software

Copyright (c) 2016-present, Facebook, Inc. All rights reserved.

Redistribution and use in source and binary forms, with or without modification,
are permitted provided that the following conditions are met:

 * Redistributions of source code must retain the above copyright notice, this
   list of conditions and the following disclaimer.

 * Redistributions in binary form must reproduce the above copyright notice,
   this list of conditions and the following disclaimer in the documentation
   and/or other materials provided with the distribution.

 * Neither the name Facebook nor the names of its contributors may be used to
   endorse or promote products derived from this software without specific
   prior written permission.

THIS SOFTWARE IS PROVIDED BY THE COPYRIGHT HOLDERS AND CONTRIBUTORS "AS IS" AND
ANY EXPRESS OR IMPLIED WARRANTIES, INCLUDING, BUT NOT LIMITED TO, THE IMPLIED
WARRANTIES OF MERCHANTABILITY AND FITNESS FOR A PARTICULAR PURPOSE ARE
DISCLAIMED. IN NO EVENT SHALL THE COPYRIGHT HOLDER OR CONTRIBUTORS BE LIABLE FOR
ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, EXEMPLARY, OR CONSEQUENTIAL DAMAGES
(INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE GOODS OR SERVICES;
LOSS OF USE, DATA, OR PROFITS; OR BUSINESS INTERRUPTION) HOWEVER CAUSED AND ON
ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT
(INCLUDING NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS
SOFTWARE, EVEN IF ADVISED OF THE POSSIBILITY OF SUCH DAMAGE.
NOTICE
echo "vendor-web: now set @types/three in package.json to the version nearest to $version, and run
  npm install --omit-lockfile-registry-resolved" >&2
