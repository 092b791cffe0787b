#!/usr/bin/env python3
"""Writes an OCI image of programs as a tarball, without a daemon: `podman load`, `docker load`, `skopeo copy oci-archive:…`.

    tools/release/oci_image.py --programs DIR --version 0.1.0 --out FILE.oci.tar

Two layers: the libraries that the programs are linked with, as this machine has them, and the programs with the shipped
configs. The same inputs give the same bytes. What the image does is that of configs/container/Containerfile.
"""
import argparse
import gzip
import hashlib
import io
import json
import os
import platform
import re
import subprocess
import sys
import tarfile
from datetime import datetime, timezone
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
USER = 10001
MADE = int(os.environ.get("SOURCE_DATE_EPOCH", "0"))
ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
COPYRIGHTS = ["/usr/share/doc/libc6/copyright", "/usr/share/doc/libgcc-s1/copyright", "/usr/share/doc/gcc-12-base/copyright"]


class Layer:
    """A layer: a tar whose entries are written in order of their names."""

    def __init__(self) -> None:
        self.entries: dict[str, tuple[tarfile.TarInfo, bytes]] = {}

    def folder(self, path: str, mode: int = 0o755, owner: int = 0) -> None:
        path = path.strip("/")
        if path and path not in self.entries:
            self.folder(os.path.dirname(path))
            self.add(path, tarfile.DIRTYPE, mode, b"", owner)

    def file(self, path: str, contents: bytes, mode: int = 0o644) -> None:
        self.folder(os.path.dirname(path))
        self.add(path, tarfile.REGTYPE, mode, contents)

    def add(self, path: str, kind: bytes, mode: int, contents: bytes, owner: int = 0) -> None:
        entry = tarfile.TarInfo(path.strip("/"))
        entry.type, entry.mode, entry.size, entry.mtime = kind, mode, len(contents), MADE
        entry.uid = entry.gid = owner
        self.entries[entry.name] = (entry, contents)

    def tar(self) -> bytes:
        written = io.BytesIO()
        with tarfile.open(fileobj=written, mode="w", format=tarfile.PAX_FORMAT) as archive:
            for _, (entry, contents) in sorted(self.entries.items()):
                archive.addfile(entry, io.BytesIO(contents))
        return written.getvalue()


def libraries(programs: list[Path]) -> set[Path]:
    """Shared libraries of the programs, with the loader, by the names under which they are asked for."""
    found: set[Path] = set()
    for program in programs:
        told = subprocess.run(["ldd", program], check=True, stdout=subprocess.PIPE, text=True).stdout
        if "not found" in told:
            sys.exit(f"oci_image.py: {program} lacks a library:\n{told}")
        found |= {Path(path) for path in re.findall(r"(/\S+) \(0x", told)}
    return found


class Blobs:
    """The files of the image's layout, by their digests."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {"oci-layout": b'{"imageLayoutVersion":"1.0.0"}'}

    def add(self, media_type: str, contents: bytes) -> dict[str, object]:
        digest = hashlib.sha256(contents).hexdigest()
        self.files[f"blobs/sha256/{digest}"] = contents
        return {"mediaType": f"application/vnd.oci.image.{media_type}", "digest": f"sha256:{digest}", "size": len(contents)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", type=Path, required=True)
    parser.add_argument("--version", required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    programs = sorted(given.programs.iterdir())

    base = Layer()
    for folder, mode in [("tmp", 0o1777), ("dev/shm", 0o1777), ("proc", 0o555), ("sys", 0o555), ("run", 0o755)]:
        base.folder(folder, mode)
    base.file("etc/passwd", b"root:x:0:0:root:/root:/sbin/nologin\njoulebus:x:%d:%d::/var/lib/joulebus:/sbin/nologin\n" % (USER, USER))
    base.file("etc/group", b"root:x:0:\njoulebus:x:%d:\n" % USER)
    for library in libraries(programs):
        base.file(str(library), library.read_bytes(), 0o755)
    for path in filter(os.path.exists, COPYRIGHTS):
        base.file(path, Path(path).read_bytes())

    added = Layer()
    for program in programs:
        added.file(f"usr/local/bin/{program.name}", program.read_bytes(), 0o755)
    for config in [ROOT / "configs/fleet.toml", *sorted((ROOT / "configs/platforms").glob("*.toml"))]:
        added.file(f"etc/joulebus/{config.relative_to(ROOT / 'configs')}", config.read_bytes())
    for licence in sorted(ROOT.glob("LICENSE-*")):
        added.file(f"usr/share/doc/joulebus/{licence.name}", licence.read_bytes())
    added.folder("var/lib/joulebus", 0o750, USER)

    blobs, layers, contents = Blobs(), [], []
    for layer in (base, added):
        plain = layer.tar()
        contents.append(f"sha256:{hashlib.sha256(plain).hexdigest()}")
        layers.append(blobs.add("layer.v1.tar+gzip", gzip.compress(plain, 9, mtime=0)))
    made = datetime.fromtimestamp(MADE, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    labels = {
        "org.opencontainers.image.title": "joulebus",
        "org.opencontainers.image.version": given.version,
        "org.opencontainers.image.source": "https://github.com/joulebus/joulebus",
        "org.opencontainers.image.licenses": "MIT OR Apache-2.0",
    }
    settings = {
        "User": f"{USER}:{USER}",
        "Env": ["PATH=/usr/local/bin", "STATE_DIRECTORY=/var/lib/joulebus"],
        "Entrypoint": ["/usr/local/bin/joulebus"],
        "Cmd": ["--help"],
        "StopSignal": "SIGTERM",
        "Labels": labels,
    }
    config = {
        "created": made,
        "architecture": ARCHITECTURES[platform.machine()],
        "os": "linux",
        "config": settings,
        "rootfs": {"type": "layers", "diff_ids": contents},
        "history": [{"created": made, "created_by": text} for text in ("libraries of the programs", "joulebus")],
    }
    encoded = lambda value: json.dumps(value, separators=(",", ":")).encode()
    described = blobs.add("config.v1+json", encoded(config))
    kind = "application/vnd.oci.image.manifest.v1+json"
    manifest = {"schemaVersion": 2, "mediaType": kind, "config": described, "layers": layers, "annotations": labels}
    listed = blobs.add("manifest.v1+json", encoded(manifest))
    listed["annotations"] = {"org.opencontainers.image.ref.name": given.version}
    kind = "application/vnd.oci.image.index.v1+json"
    blobs.files["index.json"] = encoded({"schemaVersion": 2, "mediaType": kind, "manifests": [listed]})

    whole = Layer()
    for path, data in blobs.files.items():
        whole.file(path, data)
    given.out.write_bytes(whole.tar())
    size = given.out.stat().st_size
    print(f"{given.out}: {len(programs)} programs, {len(base.entries)} and {len(added.entries)} entries, {size:,} bytes", file=sys.stderr)


if __name__ == "__main__":
    main()
