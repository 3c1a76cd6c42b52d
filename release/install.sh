#!/bin/sh
# Installs Lineside {version} without a network: sh install.sh [FOLDER], /opt/lineside where none is named.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
folder=${{1:-/opt/lineside}}
python=${{PYTHON:-python3}}
"$python" -c 'import sys; sys.exit(sys.version_info[:2] != ({major}, {minor}) and "This bundle is for Python {major}.{minor}; this is " + sys.version.split()[0] + ". Set PYTHON=/path/to/python{major}.{minor}.")'
(cd "$here" && sha256sum --quiet --check SHA256SUMS)
# Debian's Python makes an environment without pip, unless python3-venv is installed: pip comes from its wheel.
"$python" -m venv --without-pip "$folder"
set -- "$here"/wheels/pip-*.whl
"$folder/bin/python" "$1/pip" install --disable-pip-version-check --no-warn-script-location --quiet --no-index --find-links "$here/wheels" pip "lineside[{extras}]=={version}"
# For sudo, whose path has it: the command of the guides is then the same as that of the Debian package.
if [ "$folder" = /opt/lineside ] && [ -w /usr/local/bin ]; then ln -sf "$folder/bin/lineside" /usr/local/bin/lineside; fi
echo "Installed. Try it: $folder/bin/lineside demo    As a service: sudo $folder/bin/lineside install-service"
