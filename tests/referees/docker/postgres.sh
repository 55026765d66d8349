#!/bin/bash
# Postgres as the official image starts it: a cluster and a database of POSTGRES_USER, POSTGRES_PASSWORD and POSTGRES_DB, made
# when the volume is empty.
set -euo pipefail
folder=/var/lib/postgresql/data
if [[ ! -s $folder/PG_VERSION ]]; then
  [[ -n $POSTGRES_PASSWORD ]] || { echo "POSTGRES_PASSWORD is not set" >&2; exit 1; }
  initdb -D "$folder" -U "$POSTGRES_USER" -A scram-sha-256 --pwfile=<(echo "$POSTGRES_PASSWORD") --locale=C ${POSTGRES_INITDB_ARGS:-}
  echo "host all all all scram-sha-256" >>"$folder/pg_hba.conf"
  pg_ctl -D "$folder" -w -o "-c listen_addresses=" start
  PGPASSWORD=$POSTGRES_PASSWORD createdb -h /var/run/postgresql -U "$POSTGRES_USER" "$POSTGRES_DB"
  pg_ctl -D "$folder" -w stop
fi
exec postgres -D "$folder" -c 'listen_addresses=*'
