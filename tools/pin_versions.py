"""Write constraints.txt: versions of the dependencies of polywigner in this environment.

    make constraints      # after `make test-all` has passed with these versions
    python tools/pin_versions.py --lowest > lowest.txt    # the lowest permitted versions instead

The dependencies of the tests are included. Packages that are not installed in this environment have
no tested version; a comment lists them.
"""

from __future__ import annotations

import importlib.metadata
import platform
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
CONSTRAINTS = ROOT / "constraints.txt"


def declared() -> dict[str, list[Requirement]]:
    """Return the requirements of pyproject.toml by names of packages, without polywigner."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    result: dict[str, list[Requirement]] = {}
    for requirement in (Requirement(text) for texts in lists for text in texts):
        result.setdefault(canonicalize_name(requirement.name), []).append(requirement)
    del result["polywigner"]
    return result


def installed() -> tuple[dict[str, str], list[str]]:
    """Return the versions of all declared packages and their dependencies, and absent packages."""
    versions: dict[str, str] = {}
    absent = []
    waiting = [(requirement, True) for some in declared().values() for requirement in some]
    seen = set()
    while waiting:
        requirement, is_declared = waiting.pop()
        name = canonicalize_name(requirement.name)
        if (name, *requirement.extras) in seen:
            continue
        seen.add((name, *requirement.extras))
        try:
            result = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            absent += [name] if is_declared else []
            continue
        versions[name] = result.version
        for inner in map(Requirement, result.requires or []):
            extras = requirement.extras or {""}
            if inner.marker is None or any(inner.marker.evaluate({"extra": e}) for e in extras):
                waiting.append((inner, False))
    return versions, sorted(set(absent))


def lowest() -> dict[str, str]:
    """Return the lowest version of each package that pyproject.toml permits."""
    return {
        name: max(
            (s.version for r in requirements for s in r.specifier if s.operator == ">="),
            key=Version,
        )
        for name, requirements in declared().items()
    }


def main() -> None:
    if "--lowest" in sys.argv:
        print("\n".join(f"{name}=={version}" for name, version in sorted(lowest().items())))
        return
    versions, absent = installed()
    lines = [
        "# Versions with which the tests were run, for `pip install -c constraints.txt ...`.",
        f"# Written by `make constraints` with Python {platform.python_version()}.",
        f"# Not installed and therefore without a tested version: {', '.join(absent) or 'none'}.",
        *(f"{name}=={version}" for name, version in sorted(versions.items())),
    ]
    CONSTRAINTS.write_text("\n".join(lines) + "\n")
    print(f"wrote {CONSTRAINTS} ({len(versions)} packages)")


if __name__ == "__main__":
    main()
