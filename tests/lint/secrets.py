"""``python -m tests.lint.secrets``: nothing in the tracked files looks like a password, a key or a token.

A false alarm is marked on its line with ``pragma: allowlist secret`` and the reason.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from detect_secrets import SecretsCollection
from detect_secrets.settings import default_settings

ROOT = Path(__file__).resolve().parents[2]
_TEXTS = (".py", ".md", ".toml", ".yml", ".yaml", ".json", ".sh", ".txt", ".sql", "")


def main() -> int:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True)
    texts = [name for name in listed.stdout.split("\0") if name and Path(name).suffix in _TEXTS]
    found = SecretsCollection()
    with default_settings():
        for name in texts:
            if (ROOT / name).is_file():
                found.scan_file(str(ROOT / name))
    for name, secret in found:
        print(f"secrets: {Path(name).relative_to(ROOT)}:{secret.line_number}: {secret.type}")
    print(f"secrets: {len(texts)} files, {len(list(found))} suspicious")
    return 1 if list(found) else 0


if __name__ == "__main__":
    sys.exit(main())
