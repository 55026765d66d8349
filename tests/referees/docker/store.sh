#!/bin/bash
# The RADOS Gateway in the place of MinIO: its variables and its port; objects lie in the volume /data, and outlive a kill.
set -euo pipefail
rm -f /data/rgw/*.pid
RGW_ADDRESS=0.0.0.0 OSD_STORE=bluestore bash /rgw-up.sh /data/rgw 9000 "$MINIO_ROOT_USER" "$MINIO_ROOT_PASSWORD"
pids=$(cat /data/rgw/*.pid)
all_run() { for pid in $pids; do kill -0 "$pid" 2>/dev/null || return 1; done; }
trap 'kill $pids' TERM
while all_run; do
  sleep 0.5 &
  wait $! || true
done
