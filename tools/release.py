"""Rehearses a release of the commit HEAD, and uploads nothing: ``make release``.

Builds wheel and source distribution, installs each into a clean environment of every Python that is there, follows the
README outside of the tree, makes a data set, publishes it to a stand-in for the Hub and downloads it with
``huggingface_hub``. Leaves in ``dist/``: both distributions, ``SHA256SUMS``, ``NOTES.md`` of CHANGELOG.md, and the data
set's ``croissant.json``, which mlcroissant has read. Exit 1 for a step that fails; what is missing is named.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.extras.guide import blocks_of
from tests.hub.server import running_hub

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
UV = str(Path(sys.executable).parent / "uv")
PYTHONS = ("3.11", "3.12", "3.13", "3.14", "3.15")
LARGEST_WHEEL = 8_000_000  # bytes
DATA = "--count 12 --seed 1 --resolution 9 --picture 64 --device cpu --quiet"
REPO = "org/rehearsal"
DOWNLOAD = """
import sys
from huggingface_hub import snapshot_download
snapshot_download(sys.argv[1], repo_type="dataset", endpoint=sys.argv[2], local_dir=sys.argv[3])
"""


class ReleaseError(Exception):
    """A step of the rehearsal failed."""


def main() -> int:
    """Rehearse; the exit status."""
    try:
        with TemporaryDirectory(prefix="release-") as folder:
            rehearse(Path(folder))
    except ReleaseError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def rehearse(work: Path) -> None:
    """All steps, in ``work``. Raises ``ReleaseError``."""
    with step("wheel and source distribution"):
        wheel, sdist = build(work)
    environments = []
    for version in PYTHONS:
        if not (python := interpreter(version)):
            print(f"Python {version}: not found, not tried")
            continue
        for distribution in (wheel, sdist):
            environment = work / f"{version}-{distribution.suffix[1:]}"
            with step(f"Python {version}: {distribution.name} installed"):
                install(environment, python, str(distribution))
            with step(f"Python {version}: README followed"):
                follow_readme(environment, work / f"{environment.name}-readme")
            environments.append(environment)
    if not environments:
        raise ReleaseError(f"none of Python {', '.join(PYTHONS)} is here: install one")
    with step("data set made, published, downloaded"):
        published = publish(environments[0], work / "hub")
    shutil.copy(published / "croissant.json", DIST)
    with step("croissant.json read by mlcroissant"):
        validate(work / "croissant", environments[0])
    (DIST / "NOTES.md").write_text(notes())
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in (wheel, sdist)]
    (DIST / "SHA256SUMS").write_text("\n".join([*sums, ""]))
    print("written:", *(f"dist/{path.name}" for path in sorted(DIST.glob("[!.]*"))))


def build(work: Path) -> tuple[Path, Path]:
    """Wheel and source distribution of HEAD, in an emptied ``dist/``; the wheel is made of the source distribution."""
    (tree := work / "tree").mkdir()
    if changed := run("git", "status", "--porcelain", cwd=ROOT):
        print(f"not in the release, since not committed: {' '.join(changed.split()[1::2])}")
    run("git", "archive", "--output", str(work / "tree.tar"), "HEAD", cwd=ROOT)
    run("tar", "-xf", str(work / "tree.tar"), cwd=tree)
    shutil.rmtree(DIST, ignore_errors=True)
    run(UV, "build", "--quiet", "--out-dir", str(DIST), str(tree), cwd=work)
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    if (size := wheel.stat().st_size) > LARGEST_WHEEL:
        raise ReleaseError(f"{wheel}: {size / 1e6:.1f} MB, over {LARGEST_WHEEL / 1e6:g} MB: leave data out")
    print(f"{wheel.name}: {size / 1e6:.1f} MB; {sdist.name}: {sdist.stat().st_size / 1e6:.1f} MB")
    return wheel, sdist


def interpreter(version: str) -> str:
    """Path of a Python of this version, on PATH or of pyenv, whose shims find chosen ones alone; empty without one."""
    places = [*map(str, Path.home().glob(".pyenv/versions/*/bin")), os.environ.get("PATH", "")]
    command = [UV, "python", "find", "--system", "--no-python-downloads", version]
    found = subprocess.run(command, capture_output=True, env=os.environ | {"PATH": os.pathsep.join(places)})
    return found.stdout.decode().strip() if found.returncode == 0 else ""


def install(environment: Path, python: str, *packages: str) -> None:
    """A new environment with these packages, and dependencies of the versions that were tested."""
    run(UV, "venv", "--quiet", "--python", python, str(environment), cwd=environment.parent)
    command = [UV, "pip", "install", "--quiet", "--python", str(environment)]
    run(*command, "--constraint", str(ROOT / "constraints.txt"), *packages, cwd=environment.parent)


def follow_readme(environment: Path, folder: Path) -> None:
    """Run the README's commands and programs in an empty folder; blocks with a title need more than the package."""
    folder.mkdir()
    for block in blocks_of(ROOT / "README.md"):
        if block.title or block.language not in ("sh", "python"):
            continue
        commands = block.commands() if block.language == "sh" else [["python", "-c", block.text]]
        for command in commands:
            run(*command, cwd=folder, environment=environment)


def publish(environment: Path, folder: Path) -> Path:
    """Make a data set, publish it, download it with ``huggingface_hub`` and compare; the published folder."""
    folder.mkdir()
    run("gcd", "generate", "made", *DATA.split(), cwd=folder, environment=environment)
    with running_hub() as hub:
        access = {"HF_TOKEN": hub.token, "HF_HUB_DISABLE_XET": "1", "HF_HOME": str(folder / "cache")}
        words = ["made", REPO, "--license", "cc-by-4.0", "--endpoint", hub.endpoint]
        run("gcd", "publish", *words, cwd=folder, environment=environment, **access)
        words = ["-c", DOWNLOAD, REPO, hub.endpoint, "back"]
        run("python", *words, cwd=folder, environment=environment, **access)
    published, back = folder / "made" / "published", folder / "back"
    files = {path.name for path in back.iterdir() if path.is_file()}
    if not {"croissant.json", "manifest.json", "README.md", "train-00000.tar"} <= files:
        raise ReleaseError(f"{back}: a file was not downloaded: there are {', '.join(sorted(files))}")
    for name in sorted(files - {".gitattributes"}):
        if (back / name).read_bytes() != (published / name).read_bytes():
            raise ReleaseError(f"{back / name}: differs from {published / name}")
    run("gcd", "check", "back", "--bytes", cwd=folder, environment=environment)
    return published


def validate(environment: Path, base: Path) -> None:
    """Read ``dist/croissant.json`` with mlcroissant; its absence is reported. Raises ``ReleaseError``."""
    try:
        install(environment, str(base / "bin" / "python"), "mlcroissant")
    except ReleaseError as error:
        print(f"mlcroissant was not installed, croissant.json was not read: {error}")
        return
    words = ["validate", "--jsonld", str(DIST / "croissant.json")]
    run("mlcroissant", *words, cwd=environment.parent, environment=environment)


def notes() -> str:
    """The newest section of the change log."""
    return "## " + (ROOT / "CHANGELOG.md").read_text().split("\n## ")[1].rstrip() + "\n"


@contextmanager
def step(name: str) -> Iterator[None]:
    """Print the time of a step when it is done."""
    begun = time.monotonic()
    yield
    print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)


def run(*command: str, cwd: Path, environment: Path | None = None, **variables: str) -> str:
    """The output of a command, found in ``environment`` first. Raises ``ReleaseError`` with the end of its output."""
    env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    path = env["PATH"] if environment is None else f"{environment / 'bin'}{os.pathsep}{env['PATH']}"
    env |= {"PATH": path, "OMP_NUM_THREADS": "1", **variables}
    program = shutil.which(command[0], path=path) or command[0]
    done = subprocess.run([program, *command[1:]], cwd=cwd, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ReleaseError(f"{' '.join(command)}\n{(done.stdout + done.stderr)[-3000:]}\nfailed with {done.returncode}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
