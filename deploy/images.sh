#!/usr/bin/env bash
# Builds the images of the chart, and brings them into a cluster or a registry:
#   bash deploy/images.sh k3s                       this machine's k3s
#   bash deploy/images.sh kind                      the kind cluster $CLUSTER, or `kind`
#   bash deploy/images.sh containerd                this machine's containerd, as a kubelet uses it
#   bash deploy/images.sh registry.example/team/    a registry, with its slash; prints the values that name images by digest
# IMAGES names others than "gateway edge store", such as edge-gpu; TAG another tag than the chart's appVersion; DOCKER another
# program than docker, and its settings (podman, nerdctl). Those of the images, such as TORCH_INDEX, are build arguments:
# BUILD_ARGS="--build-arg TORCH_INDEX=…".
set -euo pipefail
cd "$(dirname "$0")/.."
target=${1:?"name where to: k3s, kind, containerd or a registry with its slash"}
tag=${TAG:-$(sed -n 's/^appVersion: *//p' deploy/chart/Chart.yaml)}
read -ra images <<<"${IMAGES:-gateway edge store}"
read -ra docker <<<"${DOCKER:-docker}"
read -ra build_args <<<"${BUILD_ARGS:-}"

bring() {  # NAME:TAG
  case "$target" in
    k3s) "${docker[@]}" save "$1" | k3s ctr images import - ;;
    containerd) "${docker[@]}" save "$1" | ctr --namespace k8s.io images import - ;;
    kind) kind load docker-image --name "${CLUSTER:-kind}" "$1" ;;
    */)
      "${docker[@]}" tag "$1" "$target$1"
      "${docker[@]}" push --quiet "$target$1" >/dev/null
      ;;
  esac
}

digest() {  # NAME:TAG
  "${docker[@]}" inspect --format '{{range .RepoDigests}}{{println .}}{{end}}' "$target$1" | sed -n "s|^$target||p" | head -1
}

print_values() {
  echo "image:"
  echo "  registry: $target"
  for image in "${images[@]}"; do
    case "$image" in
      gateway | edge) echo "  $image: $(digest "capture2vr-$image:$tag")" ;;
      store) store=$(digest "capture2vr-$image:$tag") ;;
      *) echo "# workers.NAME.image: $(digest "capture2vr-$image:$tag")" ;;
    esac
  done
  [[ -z "${store:-}" ]] || printf 'store:\n  image: %s\n' "$store"
}

case "$target" in
  k3s | containerd | kind | */) ;;
  *) echo "images: $target: give k3s, kind, containerd, or a registry with a slash at its end" >&2; exit 2 ;;
esac
for image in "${images[@]}"; do
  file=$image arguments=()
  if [[ "$image" == edge-gpu ]]; then file=edge arguments=(--build-arg TORCH_INDEX=); fi
  "${docker[@]}" build --file "deploy/$file.Dockerfile" --tag "capture2vr-$image:$tag" "${arguments[@]}" "${build_args[@]}" .
  bring "capture2vr-$image:$tag"
done
if [[ "$target" == */ ]]; then print_values; fi
