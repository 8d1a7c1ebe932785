#!/usr/bin/env bash
# Fetches Open Image Denoise into a folder, where programs of ../bin look for it: ./farm build and the container image call this.
# Needs python3 with venv, and PyPI. Does nothing where this version is there already.
set -euo pipefail
(($# == 1)) || {
  echo "usage: fetch-denoiser.sh FOLDER" >&2
  exit 2
}
folder=$1
wanted=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/denoiser.txt
if cmp -s "$wanted" "$folder/denoiser.txt"; then exit 0; fi

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
python3 -m venv "$scratch/venv"
"$scratch/venv/bin/pip" --disable-pip-version-check --timeout 15 --retries 2 \
  download --quiet --no-deps --require-hashes --only-binary :all: -r "$wanted" -d "$scratch"
python3 - "$scratch" <<'PYTHON'
import pathlib
import re
import sys
import zipfile

scratch = pathlib.Path(sys.argv[1])
(scratch / "lib").mkdir()
# The interface, the models, the devices that need nothing else of the wheel.
wanted = re.compile(r"pyoidn/oidn/lib/(libOpenImageDenoise(\.so\.2|_core\.so[\d.]+|_device_(cpu|cuda|hip)\.so[\d.]+)|libtbb\.so\.12)")
with zipfile.ZipFile(next(scratch.glob("*.whl"))) as wheel:
    for name in wheel.namelist():
        if wanted.fullmatch(name):
            (scratch / "lib" / pathlib.Path(name).name).write_bytes(wheel.read(name))
        elif name.endswith("/LICENSE"):
            (scratch / "lib" / "LICENSE").write_bytes(wheel.read(name))
PYTHON
mkdir -p "$folder"
rm -rf "$folder/lib"
mv "$scratch/lib" "$folder/lib"
cp "$wanted" "$folder/denoiser.txt" # last: it says that all else is there
