"""What the programs of this folder share: where scenes, references and Gleaner's own programs are; rendering and comparing.

Scenes and references are looked for in $GLEANER_SHARED (default: ../shared beside the project), programs in $GLEANER_BIN
(default: build/bin).
"""
import importlib.machinery, importlib.util, json, math, os, pathlib, subprocess, sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
SHARED = pathlib.Path(os.environ.get("GLEANER_SHARED", ROOT.parent / "shared"))
BIN = pathlib.Path(os.environ.get("GLEANER_BIN", ROOT / "build/bin"))
SCENES = {
    **{name: f"cornell-mcguire/{name}.gltf" for name in ["CornellBox-Original", "CornellBox-Water", "CornellBox-Sphere", "CornellBox-Mirror"]},
    **{name: f"{name}/{name}.gltf" for name in ["cornell-box", "sponza-dabrovic", "white-room", "breakfast-room", "modern-hall", "water-caustic"]},
}


def program(name):
    """Another program of this folder, as a module."""
    loader = importlib.machinery.SourceFileLoader(f"bench_{name}", str(pathlib.Path(__file__).resolve().parent / name))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module


def scene(name):
    """The scene's file. Ends the program where there is none."""
    path = SHARED / "scenes" / SCENES[name]
    if not path.exists():
        sys.exit(f"SKIPPED, NOTHING WAS MEASURED: no scene {path} (set GLEANER_SHARED)")
    return path


def size_of(name):
    """WxH of the scene's reference."""
    return "x".join(map(str, json.loads((SHARED / "references" / f"{name}.json").read_text())["size"]))


def render(words, folder, name):
    """Renders folder/name.exr. Returns the report."""
    report = folder / f"{name}.json"
    subprocess.run([BIN / "gleaner", "render", *words, "-o", folder / f"{name}.exr", "--report", report, "--quiet"], check=True)
    return json.loads(report.read_text())


def compared(*words):
    """What `gleaner compare` says of these files."""
    out = subprocess.run([BIN / "gleaner", "compare", *words, "--json"], check=True, capture_output=True, text=True).stdout
    return json.loads(out)


def against_reference(picture, name):
    """As compared(): the picture beside the scene's reference, whose noise is taken off."""
    reference = SHARED / "references" / name
    return compared(picture, f"{reference}.exr", "--stderr", f"{reference}.stderr.exr")


def needed(points, target):
    """Seconds to the target: error is taken for a power of time between the two counts about it."""
    at = next((k for k in range(1, len(points)) if points[k][1] <= target), None)
    if at is None:
        return None
    (t0, e0), (t1, e1) = points[at - 1][:2], points[at][:2]
    if e0 <= target:
        return t0
    return t0 * (target / e0) ** (math.log(t1 / t0) / math.log(e1 / e0))
