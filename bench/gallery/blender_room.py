#!/usr/bin/env python3
"""A room made in Blender, exported as people export it, and rendered by Cycles and by Gleaner.

    python3.11 -m venv venv && venv/bin/pip install bpy==4.5.15     (Blender as a Python module; 370 MB)
    venv/bin/python bench/gallery/blender_room.py FOLDER [--size 400x300] [--samples 512]

The room has sun through a window, a ball of glass, an arm bent by its skeleton (a skin), a lamp that glows, a coated ball
and a brushed one. Writes into FOLDER: room.glb, cycles.exr, gleaner.exr, PNGs of both under one exposure, and blocks.png:
where the two differ, block by block. Prints means and the blocks that differ most.
"""
import argparse, math, os, pathlib, subprocess, sys

import bpy
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
BIN = pathlib.Path(os.environ.get("GLEANER_BIN", ROOT / "build/bin"))
BLOCK = 20  # pixels


def material(name, color=(0.8, 0.8, 0.8), **inputs):
    m = bpy.data.materials.new(name)
    m.use_nodes = True
    shader = m.node_tree.nodes["Principled BSDF"]
    values = {"Base Color": (*color, 1), "Roughness": 1.0, "Specular IOR Level": 0.0}
    values.update(inputs)
    for key, value in values.items():
        shader.inputs[key].default_value = value
    return m


def solid(m, thickness=1.0):
    """The exporter writes KHR_materials_volume where its own node group names a thickness."""
    group = bpy.data.node_groups.get("glTF Material Output") or bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
    if not group.interface.items_tree:
        group.interface.new_socket("Thickness", in_out="INPUT", socket_type="NodeSocketFloat")
    node = m.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Thickness"].default_value = thickness
    return m


def mesh(name, vertices, faces, m):
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices, [], faces)
    data.materials.append(m)
    thing = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(thing)
    return thing


def ball(name, at, radius, m, segments=96):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2, radius=radius, location=at)
    thing = bpy.context.object
    thing.name = name
    thing.data.materials.append(m)
    bpy.ops.object.shade_smooth()
    return thing


def room():
    x, y, z = 2.0, 2.5, 2.6  # half width, half depth, height; metres, z up
    white, floor = material("white wall", (0.75, 0.73, 0.7)), material("floor", (0.45, 0.35, 0.28), Roughness=0.45, **{"Specular IOR Level": 0.5})
    red, green = material("red wall", (0.6, 0.12, 0.1)), material("green wall", (0.15, 0.45, 0.14))
    mesh("floor", [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [(0, 1, 2, 3)], floor)
    mesh("ceiling", [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)], [(3, 2, 1, 0)], white)
    mesh("back", [(-x, y, 0), (x, y, 0), (x, y, z), (-x, y, z)], [(0, 1, 2, 3)], white)
    mesh("front", [(-x, -y, 0), (x, -y, 0), (x, -y, z), (-x, -y, z)], [(3, 2, 1, 0)], white)
    mesh("left", [(-x, -y, 0), (-x, y, 0), (-x, y, z), (-x, -y, z)], [(0, 1, 2, 3)], red)
    # The right wall about a window.
    a, b, low, high = -0.6, 0.9, 0.9, 2.1
    v = [(x, -y, 0), (x, y, 0), (x, y, z), (x, -y, z), (x, a, low), (x, b, low), (x, b, high), (x, a, high)]
    mesh("right", v, [(0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)], green)


def things():
    ball("glass ball", (-0.9, 0.7, 0.45), 0.45,
         solid(material("glass", (1, 1, 1), Roughness=0.0, IOR=1.5, **{"Transmission Weight": 1.0, "Specular IOR Level": 0.5})))
    ball("coated ball", (0.15, 1.5, 0.4), 0.4,
         material("coated", (0.05, 0.12, 0.4), **{"Coat Weight": 1.0, "Coat Roughness": 0.1, "Coat IOR": 1.5}))
    ball("metal ball", (1.15, 1.2, 0.35), 0.35, material("metal", (0.9, 0.6, 0.3), Metallic=1.0, Roughness=0.3))
    ball("lamp", (-1.3, 1.9, 1.9), 0.15,
         material("glowing", (0, 0, 0), **{"Emission Color": (1, 0.75, 0.45, 1), "Emission Strength": 12.0}))


def arm():
    """A column bent by two bones."""
    rings, sides, height, radius = 24, 32, 1.6, 0.16
    v = [(radius * math.cos(2 * math.pi * k / sides), radius * math.sin(2 * math.pi * k / sides), height * i / rings)
         for i in range(rings + 1) for k in range(sides)]
    f = [(i * sides + k, i * sides + (k + 1) % sides, (i + 1) * sides + (k + 1) % sides, (i + 1) * sides + k)
         for i in range(rings) for k in range(sides)]
    f.append(tuple(rings * sides + k for k in range(sides)))
    column = mesh("arm", v, f, material("skin", (0.75, 0.5, 0.4)))
    column.data.polygons.foreach_set("use_smooth", [True] * len(column.data.polygons))
    rig = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    low, high = rig.data.edit_bones.new("low"), rig.data.edit_bones.new("high")
    low.head, low.tail, high.head, high.tail = (0, 0, 0), (0, 0, height / 2), (0, 0, height / 2), (0, 0, height)
    high.parent = low
    bpy.ops.object.mode_set(mode="OBJECT")
    for name in ("low", "high"):
        column.vertex_groups.new(name=name)
    for i in range(rings + 1):
        share = min(max((i / rings - 0.35) / 0.3, 0), 1)
        for k in range(sides):
            column.vertex_groups["low"].add([i * sides + k], 1 - share, "REPLACE")
            column.vertex_groups["high"].add([i * sides + k], share, "REPLACE")
    column.parent = rig
    column.modifiers.new("rig", "ARMATURE").object = rig
    rig.location = (1.2, 0.1, 0)
    rig.pose.bones["high"].rotation_mode = "XYZ"
    rig.pose.bones["high"].rotation_euler = (math.radians(50), 0, 0)


def light_and_camera(width, height):
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 6.0, 0.0  # W/m^2
    # Through the window, down to the floor on the left.
    sun.rotation_euler = (0, math.radians(52), math.radians(8))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.rotation_euler = (0.1, -2.4, 1.35), (math.radians(82), 0, 0)
    camera.data.lens, camera.data.sensor_width = 20, 36
    for thing in (sun, camera):
        bpy.context.collection.objects.link(thing)
    scene = bpy.context.scene
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.world = bpy.data.worlds.new("black")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0


def cycles(path, samples):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.samples, c.use_adaptive_sampling, c.use_denoising = samples, False, False
    c.max_bounces = c.diffuse_bounces = c.glossy_bounces = c.transmission_bounces = 64
    c.sample_clamp_direct = c.sample_clamp_indirect = c.blur_glossy = 0
    c.caustics_reflective = c.caustics_refractive = True
    c.pixel_filter_type = "BOX"
    scene.render.filter_size = 1.0
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def pixels(path):
    """R, G, B; row 0 at the top. By Blender's own OpenImageIO: its images do not take files of many layers."""
    beside = pathlib.Path(bpy.__file__).parents[3] / "python" / "lib"
    sys.path.append(str(next(beside.glob("python3*/site-packages"))))
    import OpenImageIO as oiio
    buffer = oiio.ImageBuf(str(path))
    names = list(buffer.spec().channelnames)
    return buffer.get_pixels(oiio.FLOAT)[:, :, [names.index(c) for c in "RGB"]].astype(np.float64)


def write_png(path, rgb):
    """8 bits, sRGB."""
    rgb = np.clip(rgb, 0, 1)
    rgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    import struct, zlib
    rows = (rgb * 255 + 0.5).astype(np.uint8)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    head = struct.pack(">IIBBBBB", rgb.shape[1], rgb.shape[0], 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b""))


def compare(folder, exposure):
    a, b = pixels(folder / "cycles.exr"), pixels(folder / "gleaner.exr")
    for name, picture in (("cycles", a), ("gleaner", b)):
        write_png(folder / (name + ".png"), picture * 2**exposure)
    print("means  Cycles %s  Gleaner %s  ratio %.4f" % (a.mean((0, 1)).round(5), b.mean((0, 1)).round(5), b.mean() / a.mean()))
    rows, columns = a.shape[0] // BLOCK, a.shape[1] // BLOCK
    grid = lambda p: p[:rows * BLOCK, :columns * BLOCK].mean(2).reshape(rows, BLOCK, columns, BLOCK).mean((1, 3))
    ga, gb = grid(a), grid(b)
    # Of the picture's mean: a dark block may differ by many times itself, and nobody sees it.
    difference = (gb - ga) / ga.mean()
    shown = np.repeat(np.repeat(difference, BLOCK, 0), BLOCK, 1)[:, :, None]
    write_png(folder / "blocks.png", np.concatenate((np.clip(shown, 0, 0.1), 0 * shown, np.clip(-shown, 0, 0.1)), 2) * 10)
    order = np.argsort(-np.abs(difference), axis=None)[:12]
    print("blocks of %d pixels: RMS difference %.4f of the mean; largest:" % (BLOCK, np.sqrt((difference**2).mean())))
    for k in order:
        y, x = divmod(int(k), columns)
        print("  at (%d, %d): Cycles %.4f, Gleaner %.4f, %+.3f of the mean" % (x * BLOCK, y * BLOCK, ga[y, x], gb[y, x], difference[y, x]))


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("--size", default="400x300")
parser.add_argument("--samples", type=int, default=512)
parser.add_argument("--exposure", type=float, default=1.0)
parser.add_argument("--compare-only", action="store_true")
args = parser.parse_args()
args.folder.mkdir(parents=True, exist_ok=True)
width, height = map(int, args.size.split("x"))
if not args.compare_only:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    room()
    things()
    arm()
    light_and_camera(width, height)
    bpy.ops.export_scene.gltf(filepath=str(args.folder / "room.glb"), export_cameras=True, export_lights=True,
                              export_rest_position_armature=False, export_animations=False)
    run = subprocess.run([BIN / "gleaner", "render", args.folder / "room.glb", "-o", args.folder / "gleaner.exr", "--size", args.size,
                          "--spp", str(args.samples), "--quiet"])
    if run.returncode:
        sys.exit(run.returncode)
    cycles(args.folder / "cycles.exr", args.samples)
compare(args.folder, args.exposure)
