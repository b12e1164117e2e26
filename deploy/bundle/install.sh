#!/usr/bin/env bash
# Installs PCMRS from this bundle, without a network: install.sh [FOLDER]. As root for the default folder, /opt.
# The version goes into FOLDER/pcmrs-VERSION, and the link FOLDER/pcmrs names it: going back is to set the link again.
set -euo pipefail
cd "$(dirname "$0")"
folder=$(realpath "${1:-/opt}")
version=$(<VERSION)
wanted=$(<PYTHON)
place=$folder/pcmrs-$version

fail() {
    echo "install.sh: $*" >&2
    exit 1
}

python=$(command -v "python$wanted" || command -v python3) ||
    fail "there is no Python: install the Debian package python3, from the installation medium if there is no network."
found=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
[[ $found == "$wanted" ]] || fail "Python is $found, and the wheels are for $wanted: use a bundle made with Python $found."
"$python" -c 'import ctypes; ctypes.CDLL("libgomp.so.1")' 2>/dev/null ||
    fail "libgomp.so.1 is missing: install the Debian package libgomp1, from the installation medium if there is no network."
[[ ! -e $place ]] || fail "$place exists: this version is installed. Remove it to install it again."
[[ ! -e $folder/pcmrs || -L $folder/pcmrs ]] ||
    fail "$folder/pcmrs is not a link of an earlier install.sh: move it away, for example to $folder/pcmrs-before."
sha256sum --check --quiet --strict SHA256SUMS || fail "the bundle is damaged: copy it again."

complete=
trap '[[ -n $complete ]] || rm -rf "$place"' EXIT
"$python" -m venv --without-pip "$place"
pip=(pip/pip-*.whl)
"$place/bin/python" "$PWD/${pip[0]}/pip" install --quiet --no-index --find-links wheels --require-hashes --no-deps \
    --no-cache-dir --disable-pip-version-check --requirement wheels.txt
"$place/bin/pcmrs" --version >/dev/null
complete=yes
ln -sfn "pcmrs-$version" "$folder/.pcmrs-link"
mv -T "$folder/.pcmrs-link" "$folder/pcmrs" # one step, which a crash leaves done or not done
echo "PCMRS $version is in $place, and $folder/pcmrs names it. The units are in $PWD/systemd (docs/deployment.md)."
