#!/usr/bin/env bash
# Builds the image pcmrs:latest, or the one named as $1, from Debian's packages and this checkout; it uses no image registry.
# As root, after: make install && apt-get install mmdebstrap buildah runc
set -euo pipefail
cd "$(dirname "$0")/../.."
image=${1:-pcmrs:latest}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Debian 12 has Python 3.11, like the environment that collects the wheels.
mmdebstrap --variant=minbase --include=ca-certificates,libgomp1,python3,python3-venv bookworm "$work/rootfs.tar"

mkdir "$work/wheels"
.venv/bin/python deploy/locked.py sim hardware >"$work/locked.txt"
.venv/bin/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir "$work/wheels" . ./sim
.venv/bin/python -m pip wheel --quiet --require-hashes --no-deps --requirement "$work/locked.txt" --wheel-dir "$work/wheels"

cp deploy/container/Containerfile "$work"
buildah bud --isolation chroot --tag "$image" "$work"
