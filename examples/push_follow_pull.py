"""Have a gateway make an asset: `python examples/push_follow_pull.py scan.ply dress result`.

Uploads a capture, follows the job that makes the asset `dress` of it, and downloads the asset, checking every hash;
with --trusted key.pub also the signature. An access key is read from CAPTURE2VR_KEY. `capture2vr up` starts a gateway.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from capture2vr import Client, GatewayError


def main() -> None:
    """Upload, start, follow, pull."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("key", help="of the asset: letters, digits and ._-")
    parser.add_argument("result", type=Path)
    parser.add_argument("--gateway", default="http://127.0.0.1:8080")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--trusted", type=Path, nargs="*", default=[], help="files of public keys")
    asked = parser.parse_args()

    try:
        with Client(asked.gateway) as client:
            capture = client.upload(asked.capture, progress=lambda each: print(f"{each.fraction:4.0%}  {each.message}"))
            job = client.start(capture, asked.key, preset=asked.preset)
            # The preview can be looked at long before the job has ended.
            for event in client.follow(job):
                print(f"{event.fraction:4.0%}  {event.stage}", event.published and f"({event.published} published)")
            client.wait(job)  # raises the reason where the job has failed
            pulled = client.pull(asked.key, asked.result, trusted=asked.trusted)
    except GatewayError as error:
        raise SystemExit(f"{error}") from None
    print(f"{pulled.key} version {pulled.version}: {', '.join(each.file for each in pulled.files)} in {pulled.folder}")


if __name__ == "__main__":
    main()
