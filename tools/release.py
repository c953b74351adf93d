"""Rehearse a release: build and check the packages, install them, and list what is left to do.

    make release                                  # the rehearsal
    python tools/release.py --date 2026-12-01     # write version and date into the other files
    python tools/release.py --install dist/*.whl --folder EMPTY   # used by .ci/run

The version is named in src/polywigner/__init__.py alone. `--date` copies it, with the day of the
release, into CITATION.cff, references.bib, the conda recipe and the changelog.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"
RECIPE = ROOT / "packaging" / "conda" / "meta.yaml"
PLACEHOLDER = "SHA256_OF_THE_SDIST"
# cffconvert requires a separate environment with old versions of common libraries.
TOOLS = [
    "build>=1.2",
    "twine>=6",
    "check-wheel-contents>=0.6",
    "validate-pyproject[all]>=0.24",
    "cffconvert>=2",
]
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]
LARGEST_SDIST = 3_000_000  # bytes

LEFT_TO_DO = """
Left to do by a person:
 1. Go through packaging/claims.md: repeat the checks, and correct pages and list.
 2. Name the authors in paper/paper.md, and answer its questions about the use of AI.
 3. Run `python tools/release.py --date YYYY-MM-DD`; review, commit and push the changes.
 4. Create {home}: issues, private vulnerability reports, Pages by Actions.
 5. On PyPI, add a trusted publisher: project polywigner, release.yml, environment pypi (no token).
 6. Wait until all jobs of tests.yml pass, also on macOS, on Windows and with the lowest versions.
 7. Run `git tag v{version} && git push origin v{version}`: release.yml builds and publishes.
 8. Connect Zenodo, make a GitHub release of the tag, and add the DOI to CITATION.cff.
 9. Build build/conda/meta.yaml with conda-build, and send it to conda-forge/staged-recipes.
10. Submit paper/paper.md to JOSS.
11. Set the next version in src/polywigner/__init__.py.
"""


def version() -> str:
    text = (ROOT / "src" / "polywigner" / "__init__.py").read_text(encoding="utf-8")
    return re.findall(r'^__version__ = "(.+)"$', text, flags=re.MULTILINE)[0]


def copies(version: str, date: str) -> dict[Path, list[tuple[str, str]]]:
    """Return the patterns of lines that contain the version or the date, and their new text."""
    citation, bibliography = ROOT / "CITATION.cff", ROOT / "src" / "polywigner" / "references.bib"
    year = date[:4]
    software = r"(@misc\{polywigner,\n(?:  .*\n)*?  version = \{).*(\},\n  year    = \{)\d+"
    return {
        citation: [
            (r"^version: .*$", f"version: {version}"),
            (r"^(# )?date-released: .*$", f"date-released: {date}"),
        ],
        bibliography: [(software, rf"\g<1>{version}\g<2>{year}")],
        RECIPE: [(r'set version = ".*"', f'set version = "{version}"')],
        ROOT / "CHANGELOG.md": [
            (rf"^## \[{re.escape(version)}\] - .*$", f"## [{version}] - {date}")
        ],
    }


def write_date(date: str) -> None:
    for path, changes in copies(version(), datetime.date.fromisoformat(date).isoformat()).items():
        text = path.read_text(encoding="utf-8")
        for pattern, line in changes:
            text, count = re.subn(pattern, line, text, flags=re.MULTILINE)
            if count != 1:
                sys.exit(f"expected one line {pattern!r} in {path}, found {count}")
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path.relative_to(ROOT)}")


def run(*command: str | Path, **options: object) -> None:
    print(
        "  $",
        " ".join(Path(part).name if Path(part).is_absolute() else str(part) for part in command),
        flush=True,
    )
    subprocess.run(
        [str(part) for part in command], check=True, cwd=options.pop("cwd", ROOT), **options
    )


def environment(folder: Path, python: str = sys.executable) -> Path:
    """Create an empty environment, and return its folder of programs."""
    run(python, "-m", "venv", folder)
    return folder / ("Scripts" if sys.platform == "win32" else "bin")


def build(tools: Path) -> tuple[Path, Path]:
    """Build the wheel and the sdist into dist/."""
    shutil.rmtree(DIST, ignore_errors=True)
    run(tools / "python", "-m", "build", "--outdir", DIST)
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    for package in (wheel, sdist):
        print(f"  {package.name}: {package.stat().st_size / 1e6:.2f} MB")
    if sdist.stat().st_size > LARGEST_SDIST:
        sys.exit(f"expected an sdist of at most {LARGEST_SDIST} bytes")
    return wheel, sdist


def check(tools: Path, wheel: Path, sdist: Path) -> None:
    run(tools / "twine", "check", "--strict", wheel, sdist)
    run(tools / "check-wheel-contents", wheel)
    run(tools / "validate-pyproject", "pyproject.toml")
    run(tools / "cffconvert", "--validate", "--infile", "CITATION.cff")


def fill_recipe(sdist: Path) -> None:
    """Write the conda recipe with the digest of the sdist."""
    digest = hashlib.sha256(sdist.read_bytes()).hexdigest()
    filled = ROOT / "build" / "conda" / "meta.yaml"
    filled.parent.mkdir(parents=True, exist_ok=True)
    filled.write_text(
        RECIPE.read_text(encoding="utf-8").replace(PLACEHOLDER, digest), encoding="utf-8"
    )
    print(f"  wrote {filled.relative_to(ROOT)}, sha256 {digest}")


def interpreters() -> Iterator[tuple[str, str]]:
    """Yield the Pythons of this machine with their versions."""
    for name in PYTHONS:
        running = name == f"{sys.version_info.major}.{sys.version_info.minor}"
        path = sys.executable if running else shutil.which(f"python{name}")
        # Shims of version managers may exist without the version.
        if path is None or subprocess.run([path, "-c", ""], capture_output=True).returncode:
            print(f"- Python {name}: not on this machine, left to the jobs of tests.yml")
        else:
            yield name, path


def install(
    package: Path, folder: Path, python: str = sys.executable, constraints: Path | None = None
) -> None:
    """Install a package into the environment of a folder, and run the example of the README there.

    An existing environment keeps the dependencies of the package that it contained.
    """
    programs = folder / "env" / ("Scripts" if sys.platform == "win32" else "bin")
    if programs.exists():
        run(programs / "python", "-m", "pip", "uninstall", "--quiet", "--yes", "polywigner")
    else:
        environment(folder / "env", python)
    options = ["--only-binary", ":all:"] if package.suffix == ".whl" else []
    if constraints is not None:
        options += ["--constraint", constraints]
    run(programs / "python", "-m", "pip", "install", "--quiet", *options, package)
    run(programs / "python", "-m", "pip", "check")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    five_lines = re.findall(r"^```python\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)[0]
    lines = folder / "five_lines.py"
    lines.write_text(f"import matplotlib\nmatplotlib.use('agg')\n{five_lines}")
    for picture in folder.glob("*.png"):
        picture.unlink()
    run(programs / "python", lines, cwd=folder)
    run(programs / "polywigner", "doctor", cwd=folder)
    if not list(folder.glob("*.png")):
        sys.exit("expected a figure of the README's five lines, found none")


def rehearse() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        print("- tools")
        tools = environment(Path(scratch, "tools"))
        run(tools / "python", "-m", "pip", "install", "--quiet", *TOOLS)
        print("- packages")
        wheel, sdist = build(tools)
        check(tools, wheel, sdist)
        fill_recipe(sdist)
        for name, python in interpreters():
            print(f"- Python {name}: installing the wheel, and running the example of the README")
            install(wheel, Path(tempfile.mkdtemp(dir=scratch)), python)
        print("- installing the sdist, and running the example of the README")
        install(sdist, Path(tempfile.mkdtemp(dir=scratch)))
    home = re.findall(r'^Homepage = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)[
        0
    ]
    print(LEFT_TO_DO.format(version=version(), home=home))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument(
        "--date",
        help="date of the release, YYYY-MM-DD: write date and version into the other files",
    )
    parser.add_argument("--install", type=Path, metavar="PACKAGE", help="only install a package")
    parser.add_argument(
        "--folder", type=Path, default=Path("build"), help="folder of its environment"
    )
    parser.add_argument("--constraints", type=Path, help="file of versions for --install")
    options = parser.parse_args()
    if options.date:
        write_date(options.date)
    elif options.install:
        install(options.install, options.folder, constraints=options.constraints)
    else:
        rehearse()


if __name__ == "__main__":
    main()
