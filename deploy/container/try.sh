#!/usr/bin/env bash
# Starts the image as compose.yaml does, but with podman alone: a router, a simulated cell that connects to it, and a viewer.
# As root, after build.sh. Exit status 0 if the cell is healthy and the viewer has seen it; leaves nothing behind.
set -euo pipefail
cd "$(dirname "$0")/../.."
image=${1:-pcmrs:latest}
pcmrs=.venv/bin/pcmrs
work=$(mktemp -d)
closed=(--read-only --cap-drop ALL --security-opt no-new-privileges --user 10001:10001
    --tmpfs /tmp:size=64m,mode=1777,noexec,nosuid,nodev --memory 4g --memory-swap 4g --pids-limit 512
    --ulimit nofile=4096:4096 --ulimit nproc=4096:4096 --ulimit core=0:0 --network try --log-driver k8s-file)

finish() {
    # Print the log of a container only if something failed.
    (($? == 0)) || for name in try-router try-cell; do podman logs "$name" >&2 || true; done
    podman rm --force --ignore --time 30 try-cell try-router >/dev/null
    podman volume rm --force try-journal >/dev/null
    podman network rm --force try >/dev/null
    rm -rf "$work"
}
trap finish EXIT

"$pcmrs" pki init --folder "$work/pki" >/dev/null
"$pcmrs" pki issue router router --cell 'lab/*' --host router --host 127.0.0.1 --folder "$work/pki" -o "$work" >/dev/null
"$pcmrs" pki issue daemon cell1 --cell lab/cell1 --folder "$work/pki" -o "$work" >/dev/null
"$pcmrs" pki issue viewer eve --cell lab/cell1 --via router --folder "$work/pki" -o "$work" >/dev/null
register=$work/pki/register.json
chown -R 10001:10001 "$work/router" "$work/cell1" "$register"
podman network create try >/dev/null
podman volume create try-journal >/dev/null

podman run --detach --name try-router "${closed[@]}" --network-alias router --publish 127.0.0.1:7449:7449 \
    --volume "$work/router:/identity:ro" --volume "$register:/register.json:ro" \
    "$image" pcmrs-router --identity /identity --register /register.json --listen tls/0.0.0.0:7449
podman run --detach --name try-cell "${closed[@]}" --ulimit rtprio=20:20 --stop-timeout 30 \
    --volume "$work/cell1:/identity:ro" --volume "$register:/register.json:ro" --volume try-journal:/var/lib/pcmrs \
    --health-cmd 'pcmrs health' --health-interval disable \
    "$image" pcmrs-serve --set access.identity=/identity --set access.register=/register.json \
    --set 'access.routers=["tls/router:7449"]'

for _ in {1..60}; do
    podman healthcheck run try-cell >/dev/null 2>&1 && break
    sleep 1
done
podman healthcheck run try-cell
"$pcmrs" state --endpoint tls/127.0.0.1:7449 --identity "$work/eve"
podman exec try-cell sh -c '! touch /opt/x 2>/dev/null && grep -E "CapEff|NoNewPrivs" /proc/1/status'
podman stop try-cell
test "$(podman inspect --format '{{.State.ExitCode}}' try-cell)" = 0 # it ended by itself, at SIGTERM
