#!/usr/bin/env bash
# Prepare this checkout to run on Debian with Python 3.11 or newer.
#   setup.sh product   .venv with the product (enough for `make demo`)
#   setup.sh tests     also what the tests drive: Chromium, Node, mono, the Docker command line, what unpacks Godot
# Without a CUDA device PyTorch's CPU build is taken, from TORCH_CPU_INDEX, by default PyTorch's own index; where that does not
# answer, from where pip finds packages. A PyTorch that .venv has already stays.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
torch_index=${TORCH_CPU_INDEX:-https://download.pytorch.org/whl/cpu}

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

# pip_install ARGUMENT...: install into .venv, otherwise say in one sentence what is missing.
pip_install() {
  .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt "$@" || { say_what_is_missing >&2; return 1; }
}

say_what_is_missing() {
  echo "setup: pip could not install $(.venv/bin/python deploy/missing.py);" \
    "connect this machine to a package index, or name a folder of wheels (export PIP_NO_INDEX=1 PIP_FIND_LINKS=folder)," \
    "then run make again"
}

has_cuda() { [[ -e /dev/nvidia0 ]] || { have nvidia-smi && nvidia-smi -L >/dev/null 2>&1; }; }

answers() { "$python" -c 'import sys, urllib.request; urllib.request.urlopen(sys.argv[1], timeout=5)' "$1" 2>/dev/null; }

# PyTorch's CPU build: the one that pip takes by itself on Linux brings CUDA along, and is ten times as large.
torch_for_cpu() {
  if has_cuda || .venv/bin/python -c 'import importlib.metadata as found; found.version("torch")' 2>/dev/null; then
    return
  fi
  if answers "$torch_index/torch/"; then
    .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt --no-deps --index-url "$torch_index" torch &&
      return
  fi
  echo "setup: no CPU build of PyTorch from $torch_index; pip takes PyTorch from where it finds packages" >&2
  pip_install torch
}

product() {
  have "$python" || apt_install "the product" python3 python3-venv
  "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    { echo "setup: Python 3.11 or newer is needed; name one with PYTHON=..." >&2; exit 1; }
  if [[ ! -x .venv/bin/pip ]]; then  # Debian without python3-venv leaves one without pip behind
    "$python" -m venv .venv 2>/dev/null || { apt_install "a virtual environment" python3-venv; "$python" -m venv .venv; }
  fi
  torch_for_cpu
  pip_install -e '.[gateway,edge,storage]'
  # Simplification by meshoptimizer is built from source; without a compiler the wheel of fast-simplification serves.
  if have g++; then
    .venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fast]' 2>/dev/null ||
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
  pip_install -e '.[dev,learned-matching]'
}

"$1"
