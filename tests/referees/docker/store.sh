#!/bin/bash
# SeaweedFS in the place of MinIO: its variables and its port; objects lie in the volume /data, and outlive a kill.
set -euo pipefail
cat >/tmp/keys.json <<JSON
{"identities": [{"name": "root", "actions": ["Admin"],
  "credentials": [{"accessKey": "$MINIO_ROOT_USER", "secretKey": "$MINIO_ROOT_PASSWORD"}]}]}
JSON
exec /weed mini -dir=/data -ip=127.0.0.1 -ip.bind=0.0.0.0 -s3.port=9000 -s3.config=/tmp/keys.json -s3.autoCreateBucket=false \
  -s3.port.iceberg=0 -s3.port.lance=0 -admin.ui=false -webdav=false -master.telemetry=false
