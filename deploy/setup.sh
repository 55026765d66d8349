#!/usr/bin/env bash
# Prepare this checkout to run on Debian with Python 3.11 or newer.
#   setup.sh product   .venv with the product (enough for `make demo`)
#   setup.sh tests     also what the tests drive: Chromium, Node, mono, the Docker command line, what unpacks Godot
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}

# apt_install WHY PACKAGE...: as root install, otherwise say in one sentence what to install.
apt_install() {
  local why=$1
  shift
  if [[ $(id -u) != 0 ]]; then
    echo "setup: $why needs Debian packages; run once: sudo apt-get install --no-install-recommends $*" >&2
    return 1
  fi
  [[ -n ${apt_updated:-} ]] || { DEBIAN_FRONTEND=noninteractive apt-get update -qq; apt_updated=1; }
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

have() { command -v "$1" >/dev/null 2>&1; }

product() {
  have "$python" || apt_install "the product" python3 python3-venv
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    { echo "setup: Python 3.11 or newer is needed; name one with PYTHON=..." >&2; exit 1; }
  if [[ ! -x .venv/bin/pip ]]; then  # Debian without python3-venv leaves one without pip behind
    "$python" -m venv .venv 2>/dev/null || { apt_install "a virtual environment" python3-venv; "$python" -m venv .venv; }
  fi
  .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[gateway,edge,storage]'
  # Simplification by meshoptimizer is built from source; without a compiler the wheel of fast-simplification serves.
  if have g++; then
    .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fast]' ||
      echo "setup: meshoptimizer could not be built; fast-simplification makes the levels of detail" >&2
  fi
}

tests() {
  local packages=()
  have chromium-headless-shell || have chromium || packages+=(chromium-headless-shell)
  have node || packages+=(nodejs)
  have npm || packages+=(npm)
  have curl || packages+=(curl)
  compgen -G '/usr/lib/postgresql/*/bin/postgres' >/dev/null || packages+=(postgresql)
  have nginx || packages+=(nginx-core)
  have git || packages+=(git)
  have mmdebstrap || packages+=(mmdebstrap)  # unpacks Godot, which this Debian does not have
  have mcs || packages+=(mono-mcs mono-runtime libmono-system-core4.0-cil libmono-system-net-http4.0-cil
    libmono-system-numerics4.0-cil)
  [[ ${#packages[@]} == 0 ]] || apt_install "the test suite" "${packages[@]}" ||
    echo "setup: tests that need them will be skipped" >&2
  have docker || apt_install "the compose tests" docker.io ||
    echo "setup: the compose tests will be skipped" >&2
  .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r deploy/learned-matching.txt
  .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,learned-matching]'
}

"$1"
