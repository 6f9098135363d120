#!/usr/bin/env bash
# Write requirements.txt anew: everything a fresh environment takes for `.[dev]`, pinned, without download addresses.
set -euo pipefail
fresh=$(mktemp -d)
python3 -m venv "$fresh"
"$fresh/bin/pip" install --quiet --disable-pip-version-check '.[dev]' hatchling editables
{
  echo "# Every package of the development environment, pinned.  Written by \`make pins\`; no download addresses on purpose."
  "$fresh/bin/pip" freeze | grep -vi '^deshybrid' |
    sed 's/^faudes==.*/&; sys_platform == "linux" and platform_machine == "x86_64"/'  # no other system has its wheel
} > requirements.txt
rm -rf "$fresh"
