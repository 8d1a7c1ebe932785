"""What the programs of this folder share: where scenes, references and Gleaner's own programs are; rendering and comparing.

Scenes and references are looked for in $GLEANER_SHARED (default: ../shared beside the project), programs in $GLEANER_BIN
(default: build/bin). Smaller references need a Python with numpy and OpenEXR.
"""
import atexit, functools, importlib.machinery, importlib.util, json, math, os, pathlib, struct, subprocess, sys, tempfile

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


def size_of(name, shrink=1):
    """WxH of the scene's reference, or of one that is smaller by a whole factor."""
    sides = json.loads((SHARED / "references" / f"{name}.json").read_text())["size"]
    if any(side % shrink for side in sides):
        sys.exit(f"{name}: {sides[0]}x{sides[1]} pixels are not whole blocks of {shrink}x{shrink}")
    return "x".join(str(side // shrink) for side in sides)


def render(words, folder, name):
    """Renders folder/name.exr. Returns the report."""
    report = folder / f"{name}.json"
    subprocess.run([BIN / "gleaner", "render", *words, "-o", folder / f"{name}.exr", "--report", report, "--quiet"], check=True)
    return json.loads(report.read_text())


def compared(*words):
    """What `gleaner compare` says of these files."""
    out = subprocess.run([BIN / "gleaner", "compare", *words, "--json"], check=True, capture_output=True, text=True).stdout
    return json.loads(out)


@functools.cache
def reference_files(name, shrink):
    """The scene's reference and its standard errors. Smaller by a whole factor: means over blocks, which is what pixels of that size see."""
    files = [SHARED / "references" / f"{name}{kind}.exr" for kind in ("", ".stderr")]
    if shrink == 1:
        return files
    try:
        import numpy, OpenEXR
    except ImportError:
        sys.exit("SKIPPED, NOTHING WAS MEASURED: smaller references need numpy and OpenEXR (pip install numpy OpenEXR)")
    temporary = tempfile.TemporaryDirectory()
    atexit.register(temporary.cleanup)

    def means(file):
        channels = OpenEXR.File(str(file)).channels()
        image = channels["RGB"].pixels if "RGB" in channels else numpy.stack([channels[c].pixels for c in "RGB"], -1)
        height, width = (side // shrink for side in image.shape[:2])
        blocks = image.astype(float).reshape(height, shrink, width, shrink, 3)
        # The square of a mean's standard error is that of the values over their number.
        return numpy.sqrt((blocks**2).mean((1, 3))) / shrink if file.stem.endswith(".stderr") else blocks.mean((1, 3))

    smaller = [pathlib.Path(temporary.name) / file.name for file in files]
    for file, to in zip(files, smaller):
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": numpy.ascontiguousarray(means(file), numpy.float32)}) as exr:
            exr.write(str(to))
    return smaller


def against_reference(picture, name, shrink=1):
    """As compared(): the picture beside the scene's reference, whose noise is taken off."""
    reference, noise = reference_files(name, shrink)
    return compared(picture, reference, "--stderr", noise)


def block_error(picture, reference, worst=0.01):
    """Root mean square of the differences of means over blocks of 8 x 8 pixels, over the reference's mean, without the `worst` part of the blocks."""
    import numpy, OpenEXR

    def blocks(path):
        channels = OpenEXR.File(str(path)).channels()
        image = channels["RGB"].pixels if "RGB" in channels else numpy.stack([channels[c].pixels for c in "RGB"], -1)
        height, width = (size // 8 for size in image.shape[:2])
        return image[:8 * height, :8 * width].astype(float).reshape(height, 8, width, 8, 3).mean((1, 3))

    picture, reference = blocks(picture), blocks(reference)
    squared = numpy.sort(((picture - reference) ** 2).mean(-1).ravel())
    return float(numpy.sqrt(squared[:len(squared) - int(worst * len(squared))].mean()) / reference.mean())


def lambert_hall(folder):
    """The library's hall without its polished floor, as .gltf beside a .bin."""
    subprocess.run([BIN / "gleaner", "scene", "hall", "-o", folder / "hall.glb"], check=True, stdout=subprocess.DEVNULL)
    data = (folder / "hall.glb").read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    gltf = json.loads(data[20:20 + length])
    for material in gltf["materials"]:
        material["pbrMetallicRoughness"].update(metallicFactor=0, roughnessFactor=1)
        material.setdefault("extensions", {})["KHR_materials_specular"] = {"specularFactor": 0}
    (folder / "hall.bin").write_bytes(data[28 + length:])
    gltf["buffers"][0]["uri"] = "hall.bin"
    (folder / "hall.gltf").write_text(json.dumps(gltf))
    return folder / "hall.gltf"


def seconds_to(points, error):
    """Seconds to an error that is a power of time through both points, (seconds, error) each."""
    (t0, e0), (t1, e1) = points
    return t0 * (error / e0) ** (math.log(t1 / t0) / math.log(e1 / e0))


def needed(points, target):
    """Seconds to the target: error is taken for a power of time between the two counts about it. The first count's where it is met by that."""
    if points and points[0][1] <= target:
        return points[0][0]
    at = next((k for k in range(1, len(points)) if points[k][1] <= target), None)
    if at is None:
        return None
    return seconds_to((points[at - 1][:2], points[at][:2]), target)
