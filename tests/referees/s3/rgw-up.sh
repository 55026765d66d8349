#!/usr/bin/env bash
# Start a real S3 server (Ceph RADOS Gateway: one monitor, one OSD, one gateway) on loopback and create one S3 user.
#   rgw-up.sh DIR PORT ACCESS_KEY SECRET_KEY     -> endpoint http://127.0.0.1:PORT ; uses PORT+1 too ; pids in DIR/*.pid
# Debian: apt-get install --no-install-recommends radosgw ceph-mon ceph-osd ceph-common
# Stop it with: kill $(cat DIR/*.pid), and wait until all three are gone.
# OSD_STORE=bluestore keeps objects in DIR, where a second call finds them; by default they stay in memory, for nothing outlives
# the tests. RGW_ADDRESS is where it listens, loopback by default. The monitor waits 1 s before it proposes the next change, and every
# pool is one: 20 ms bring the first bucket up in 4 s instead of 20. Without tcp_nodelay every answer waits 40 ms for the
# client's delayed acknowledgement.
set -euo pipefail
dir=$(mkdir -p "$1" && cd "$1" && pwd) port=$2 access=$3 secret=$4
conf=$dir/ceph.conf key=$dir/keyring
mkdir -p "$dir"/{run,mon,osd}
known=$([[ -e $dir/made ]] && echo yes || echo no)
[[ $known == yes ]] || cat >"$conf" <<CONF
[global]
fsid = $(cat /proc/sys/kernel/random/uuid)
auth_cluster_required = cephx
auth_service_required = cephx
auth_client_required = cephx
mon_host = v2:127.0.0.1:$((port + 1))
mon_initial_members = a
public_network = 127.0.0.0/8
cluster_network = 127.0.0.0/8
public_addr = 127.0.0.1
run_dir = $dir/run
admin_socket = $dir/run/\$name.\$pid.asok
log_file = $dir/\$name.log
paxos_propose_interval = 0.02
paxos_min_wait = 0.02
osd_pool_default_size = 1
osd_pool_default_min_size = 1
mon_allow_pool_size_one = true
osd_crush_chooseleaf_type = 0
osd_pool_default_pg_num = 4
osd_pool_default_pg_autoscale_mode = off
mon_max_pg_per_osd = 500
ms_bind_ipv6 = false
ms_bind_msgr1 = false
keyring = $key
[mon]
mon_data = $dir/mon
[osd]
osd_data = $dir/osd
osd_objectstore = ${OSD_STORE:-memstore}
bluestore_block_size = 4294967296
osd_memory_target = 939524096
[client]
rgw_frontends = beast endpoint=${RGW_ADDRESS:-127.0.0.1}:$port tcp_nodelay=1
rgw_data = $dir
CONF
if [[ $known == no ]]; then
  fsid=$(sed -n 's/^fsid = //p' "$conf")
  ceph-authtool --create-keyring "$key" --gen-key -n client.admin --cap mon 'allow *' --cap osd 'allow *' --cap mgr 'allow *'
  ceph-authtool "$key" --gen-key -n client.rgw --cap mon 'allow *' --cap osd 'allow *'
  ceph-authtool "$key" --gen-key -n osd.0 --cap mon 'allow profile osd' --cap osd 'allow *'
  ceph-authtool "$key" --gen-key -n mon. --cap mon 'allow *'
  monmaptool --create --fsid "$fsid" --addv a "[v2:127.0.0.1:$((port + 1))]" "$dir/monmap"
  ceph-mon -c "$conf" --mkfs -i a --monmap "$dir/monmap" --keyring "$key"
fi
setsid ceph-mon -c "$conf" -i a -f >"$dir/mon.out" 2>&1 & echo $! >"$dir/mon.pid"
until timeout 5 ceph -c "$conf" mon stat >/dev/null 2>&1; do sleep 0.3; done
if [[ $known == no ]]; then
  uuid=$(cat /proc/sys/kernel/random/uuid)
  ceph -c "$conf" osd new "$uuid"
  ceph -c "$conf" auth add osd.0 -i "$key"
  ceph-osd -c "$conf" -i 0 --mkfs --osd-uuid "$uuid"
fi
setsid ceph-osd -c "$conf" -i 0 -f >"$dir/osd.out" 2>&1 & echo $! >"$dir/osd.pid"
# Before the gateway answers, so that nobody is refused who comes early.
[[ $known == yes ]] || radosgw-admin -c "$conf" -n client.rgw user create --uid capture2vr --display-name capture2vr \
  --access-key "$access" --secret "$secret"
setsid radosgw -c "$conf" -n client.rgw -f >"$dir/rgw.out" 2>&1 & echo $! >"$dir/rgw.pid"
for _ in $(seq 200); do curl -so /dev/null "http://127.0.0.1:$port" && break; sleep 0.3; done
touch "$dir/made"
echo "http://127.0.0.1:$port"
