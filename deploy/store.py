"""Start SeaweedFS as the S3 store of docker-compose.yml, on port 9000, with one user who may do everything.

Of its parts only S3 is reached from elsewhere. Master, volume and filer ask nobody for a key, so they listen on
loopback. S3 itself has a second port, for gRPC, by which anybody could make himself a user: it wants a client
certificate, and the only key that could sign one is made here and known to nobody.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

KEYS = Path(tempfile.gettempdir())

COMMAND = (
    *("weed", "server", "-dir=/data", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", "-master.telemetry=false"),
    # A second in place of ten until a store that has data answers: there is no other master to hear of.
    *("-master.electionTimeout=1s", "-volume.preStopSeconds=1"),
    # Files of at most 1 GB, as many as the disk has room for: space is given back file by file.
    *("-master.volumeSizeLimitMB=1024", "-volume.max=0", "-filer"),
    *("-s3", "-s3.ip.bind=0.0.0.0", "-s3.port=9000", f"-s3.config={KEYS / 'users.json'}"),
    *("-s3.iam=false", "-s3.port.iceberg=0", "-s3.port.lance=0"),
    # A bucket that a put makes, and pages that read without the bucket's own rule (CORS), are ideas of its own.
    *("-s3.autoCreateBucket=false", "-s3.allowedOrigins=http://nobody.example"),
)

MASTER = {
    # Every quarter of an hour: parts of uploads that were cut off, which no listing shows.
    "WEED_MASTER_MAINTENANCE_SCRIPTS": "s3.clean.uploads -timeAgo=24h",
    # A bucket gets one volume at a time, in place of seven: on a disk with room for six, the second got none.
    "WEED_MASTER_VOLUME_GROWTH_COPY_1": "1",
}


def secret() -> str:
    """Return STORAGE_SECRET_KEY, or where that is empty what the file STORAGE_SECRET_KEY_FILE holds."""
    return os.environ.get("STORAGE_SECRET_KEY") or Path(os.environ["STORAGE_SECRET_KEY_FILE"]).read_text().strip()


def write_users() -> None:
    """Write the user. Whoever brings no key may do what the bucket's policy says."""
    key = {"accessKey": os.environ["STORAGE_ACCESS_KEY"], "secretKey": secret()}
    users = {"identities": [{"name": "capture2vr", "credentials": [key], "actions": ["Admin"]}]}
    (KEYS / "users.json").write_text(json.dumps(users))


def certificate() -> dict[str, str]:
    """Make a certificate that is its own authority; return the variables by which SeaweedFS takes it for S3's gRPC."""
    own, private = KEYS / "grpc.crt", KEYS / "grpc.key"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-noenc"]
    command += ["-days", "36500", "-subj", "/CN=store", "-keyout", str(private), "-out", str(own)]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)  # noqa: S603 - nothing of it is a stranger's
    return {"WEED_GRPC_CA": str(own), "WEED_GRPC_S3_CERT": str(own), "WEED_GRPC_S3_KEY": str(private)}


if __name__ == "__main__":
    os.umask(0o077)
    write_users()
    os.execvpe(COMMAND[0], [*COMMAND, *sys.argv[1:]], os.environ | MASTER | certificate())  # noqa: S606
