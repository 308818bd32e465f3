"""``python -m tests.lint.dependencies``: known vulnerabilities of what requirements.lock names.

Fails if there are any. Where no vulnerability database can be reached it says that nothing was audited, and passes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

LOCK = Path(__file__).resolve().parents[2] / "requirements.lock"


def main() -> int:
    command = [sys.executable, "-m", "pip_audit", "--requirement", str(LOCK), "--no-deps", "--disable-pip"]
    command += ["--format", "json", "--progress-spinner", "off", "--timeout", "5"]
    try:
        ran = subprocess.run(command, capture_output=True, text=True, timeout=180)
        listed = json.loads(ran.stdout)["dependencies"]
    except (subprocess.TimeoutExpired, ValueError, KeyError):
        print("dependencies: NOT AUDITED, the vulnerability database cannot be reached from here")
        return 0
    audited = [item for item in listed if "skip_reason" not in item]
    found = [item for item in audited if item["vulns"]]
    for item in found:
        for known in item["vulns"]:
            fixed = ", ".join(known["fix_versions"]) or "no version yet"
            print(f"dependencies: {item['name']} {item['version']}: {known['id']}, fixed in {fixed}")
    missing = len(listed) - len(audited)
    if not audited:
        print("dependencies: NOT AUDITED, the vulnerability database cannot be reached from here")
    else:
        print(f"dependencies: {len(audited)} audited, {missing} unknown there, {len(found)} vulnerable")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
