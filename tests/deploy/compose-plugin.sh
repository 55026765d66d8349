#!/usr/bin/env bash
# Put the docker CLI's compose plugin (version 2) into DIR, for Debian releases that do not carry it.
#   compose-plugin.sh DIR
# The package of the next Debian release is downloaded through an apt directory of its own, from the mirror that this
# machine already uses, checked by apt's signatures, and unpacked without being installed.
set -euo pipefail
dir=$(mkdir -p "$1" && cd "$1" && pwd)
[[ ! -x $dir/cli-plugins/docker-compose ]] || exit 0
apt=$dir/apt
mkdir -p "$apt"/{lists/partial,cache/archives/partial,parts}
mirror=$(grep -rhoE 'https?://[^ ]+/debian/?( |$)' /etc/apt/sources.list /etc/apt/sources.list.d 2>/dev/null | head -1 | tr -d ' ' || true)
keyring=/usr/share/keyrings/debian-archive-keyring.gpg
echo "deb [signed-by=$keyring] $mirror trixie main" >"$apt/sources.list"
options=(-o "Dir::Etc::SourceList=$apt/sources.list" -o "Dir::Etc::SourceParts=$apt/parts" -o "Dir::State::Lists=$apt/lists"
  -o "Dir::Cache=$apt/cache" -o APT::Sandbox::User=root)
apt-get "${options[@]}" update -qq
(cd "$apt" && apt-get "${options[@]}" download -qq docker-compose >/dev/null)
dpkg-deb -x "$apt"/docker-compose_*.deb "$apt/root"
mkdir -p "$dir/cli-plugins"
cp "$(find "$apt/root/usr" -path "*cli-plugins/docker-compose" | head -1)" "$dir/cli-plugins/docker-compose"
rm -rf "$apt"
