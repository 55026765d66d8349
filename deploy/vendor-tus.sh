#!/usr/bin/env bash
# Fetch tus-js-client, which sends uploads that can go on, into services/web/vendor: from npm, as ES modules, unmodified but
# for their import lines. Its js-base64 comes along; url-parse does not, for the browser's own URL does the same here.
#   vendor-tus.sh VERSION        e.g. 4.3.1
set -euo pipefail
version=$1
vendor=$(cd "$(dirname "$0")/../services/web/vendor" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$scratch"
npm pack --silent "tus-js-client@$version" >/dev/null
tar xzf "tus-js-client-$version.tgz"
rm -f "$vendor"/tus-js-client-*
prefix=tus-js-client-$version
modules=$(cd package/lib.esm && ls *.js browser/*.js browser/sources/*.js)
for module in $modules; do
  sed -E "s#^(import|export)(.*) from '[./]*(browser/)?(sources/)?([A-Za-z]+)\.js';#\1\2 from './$prefix.\5.js';#
    s#^import \{ Base64 \} from 'js-base64';#import { Base64 } from './$prefix.base64.js';#; /^import URL from 'url-parse';/d" \
    "package/lib.esm/$module" >"$vendor/$prefix.$(basename "$module")"
done
# Types for the TypeScript compiler of `make lint`, without those of Node.js.
sed 's#\bBuffer | ##' package/lib/index.d.ts >"$vendor/$prefix.index.d.ts"
base64=$(sed -nE 's#.*"js-base64": "\^([0-9.]+)".*#\1#p' package/package.json)
npm pack --silent "js-base64@$base64" >/dev/null
tar xzOf "js-base64-$base64.tgz" package/base64.mjs >"$vendor/$prefix.base64.js"
# Our own modules name the version too.
sed -i -E "s#/tus-js-client-[0-9]+\.[0-9]+\.[0-9]+\.#/$prefix.#" "$vendor"/../*/*.js
# notice FILE TITLE PURL LICENCE: two lines that release/vendored.py reads, and behind them the licence.
notice() { { printf '%s\n%s\n\n' "$2" "$3"; cat "$4"; } >"$vendor/$prefix.$1"; }
notice LICENSE "tus-js-client $version (MIT): $(basename -a $modules | paste -sd ' ')" "pkg:npm/tus-js-client@$version" package/LICENSE
tar xzf "js-base64-$base64.tgz" -C "$scratch" --transform 's#^package#base64#'
notice base64.LICENSE "js-base64 $base64 (BSD-3-Clause): base64.js" "pkg:npm/js-base64@$base64" base64/LICENSE.md
