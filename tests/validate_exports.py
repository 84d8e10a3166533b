#!/usr/bin/env python3
"""Checks exported files with readers that are not caphy's.

    cargo run -p caphy-formats --example write_samples -- DIR
    python3 tests/validate_exports.py DIR [--require-all]

DIR may be any folder of exports (searched with its subfolders). Where it holds `expected.json`, which the samples bring
along, positions, faces, colours and texture coordinates are compared with it; otherwise files are read, validated and
checked for finite positions and faces in range.

What reads what (a missing reader is named in a SKIPPED line; with --require-all it is a failure):
    .glb    Khronos validator (npm gltf-validator; NODE_PATH names its node_modules), then skins, morph targets and
            channels are evaluated here by the formulas of the glTF 2.0 specification (numpy)
    .usda   Pixar's library (PyPI usd-core)
    .obj    trimesh with pillow (PyPI), folders of frame_*.obj as sequences
    .pc2    struct and numpy, by the description of the format
    .ply    trimesh and plyfile (PyPI)

Exit: 0 nothing wrong, 1 something wrong or nothing found, 2 wrong usage.
"""

import json
import re
import struct
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

try:
    import numpy as np
except ImportError:
    np = None


class Report:
    def __init__(self):
        self.checked, self.failed, self.skipped = [], [], []

    def ok(self, path, what):
        self.checked.append(path)
        print(f"ok      {path}: {what}")

    def fail(self, path, what):
        self.failed.append(path)
        print(f"FAILED  {path}: {what}")

    def skip(self, path, what):
        self.skipped.append(path)
        print(f"SKIPPED {path}: {what}")


class Wrong(Exception):
    """A file is not what it should be."""


def require(condition, what):
    if not condition:
        raise Wrong(what)


def close(got, wanted, what, tolerance):
    got, wanted = np.asarray(got, float), np.asarray(wanted, float)
    require(got.shape == wanted.shape, f"{what}: shape {got.shape}, expected {wanted.shape}")
    require(np.isfinite(got).all(), f"{what}: not finite")
    worst = np.abs(got - wanted).max() if got.size else 0.0
    require(worst <= tolerance, f"{what}: differs by {worst:.3g}, allowed {tolerance:.3g}")


def single(wanted):
    """As a file of 32-bit numbers holds them."""
    return np.asarray(wanted, np.float64).astype(np.float32)


def sound(vertices, faces, what):
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    require(len(vertices) > 0 and np.isfinite(vertices).all(), f"{what}: no vertices, or not finite")
    require(faces.size == 0 or (faces.min() >= 0 and faces.max() < len(vertices)), f"{what}: face ids out of range")


def linear(colours):
    """Linear light of 8-bit sRGB (IEC 61966-2-1)."""
    c = np.asarray(colours, float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


# ---------------------------------------------------------------------------------------------------------- GLB


class Glb:
    KINDS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32} if np else {}
    WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

    def __init__(self, data):
        magic, version, length = struct.unpack_from("<4sII", data)
        require(magic == b"glTF" and version == 2 and length == len(data), "no GLB 2.0 of the length that it says")
        size, kind = struct.unpack_from("<I4s", data, 12)
        require(kind == b"JSON", "first chunk is not JSON")
        self.json = json.loads(data[20 : 20 + size])
        size_bin, kind = struct.unpack_from("<I4s", data, 20 + size)
        require(kind == b"BIN\0" and 28 + size + size_bin == len(data), "second chunk is not the rest as BIN")
        self.bin = data[28 + size :]

    def array(self, number):
        a = self.json["accessors"][number]
        view = self.json["bufferViews"][a["bufferView"]]
        require("byteStride" not in view and "sparse" not in a, "a layout that this script does not read")
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        width = self.WIDTHS[a["type"]]
        kind = self.KINDS[a["componentType"]]
        out = np.frombuffer(self.bin, kind, a["count"] * width, start).reshape(a["count"], width)
        if a.get("normalized"):
            out = out / np.iinfo(kind).max
        return out

    def tracks(self):
        """(node, path) -> times, values."""
        out = {}
        for animation in self.json.get("animations", []):
            for channel in animation["channels"]:
                sampler = animation["samplers"][channel["sampler"]]
                key = (channel["target"]["node"], channel["target"]["path"])
                out[key] = (self.array(sampler["input"])[:, 0], self.array(sampler["output"]))
        return out


def quaternion_matrix(q):
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def glb_frames(glb):
    """name -> (faces, [vertices per frame], colours, times) at the keys of the animation."""
    nodes = glb.json["nodes"]
    tracks = glb.tracks()
    parents = {child: parent for parent, node in enumerate(nodes) for child in node.get("children", [])}

    def local(node, key):
        t = tracks.get((node, "translation"))
        r = tracks.get((node, "rotation"))
        out = np.eye(4)
        out[:3, :3] = quaternion_matrix(r[1][key].astype(float) if r else nodes[node].get("rotation", [0, 0, 0, 1]))
        out[:3, 3] = t[1][key] if t else nodes[node].get("translation", [0, 0, 0])
        return out

    def world(node, key):
        out = local(node, key)
        while node in parents:
            node = parents[node]
            out = local(node, key) @ out
        return out

    result = {}
    for number, node in enumerate(nodes):
        if "mesh" not in node:
            continue
        mesh = glb.json["meshes"][node["mesh"]]
        require(len(mesh["primitives"]) == 1, f"{node['name']}: more than one primitive")
        primitive = mesh["primitives"][0]
        rest = glb.array(primitive["attributes"]["POSITION"]).astype(float)
        faces = glb.array(primitive["indices"]).reshape(-1, 3)
        colour = primitive["attributes"].get("COLOR_0")
        frames, times = [rest], None
        if "targets" in primitive:
            times, weights = tracks[(number, "weights")]
            targets = [glb.array(t["POSITION"]).astype(float) for t in primitive["targets"]]
            weights = weights.reshape(len(times), len(targets))
            frames = [rest + sum(w * t for w, t in zip(row, targets) if w) for row in weights]
        if "skin" in node:
            skin = glb.json["skins"][node["skin"]]
            times = next(t for (n, _), (t, _) in tracks.items() if n in skin["joints"])
            inverse = glb.array(skin["inverseBindMatrices"]).astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
            ids = glb.array(primitive["attributes"]["JOINTS_0"])
            weights = glb.array(primitive["attributes"]["WEIGHTS_0"]).astype(float)
            points = np.hstack([rest, np.ones((len(rest), 1))])
            frames = []
            for key in range(len(times)):
                joints = np.stack([world(j, key) for j in skin["joints"]]) @ inverse
                frames.append(np.einsum("vk,vkab,vb->va", weights, joints[ids], points)[:, :3])
        result[node["name"]] = (faces, frames, glb.array(colour) if colour is not None else None, times)
    return result


def check_glb(path, expected, report):
    script = ROOT / "crates/formats/tests/validate_glb.mjs"
    try:
        run = subprocess.run(["node", str(script), str(path)], capture_output=True, text=True, timeout=600)
    except FileNotFoundError:
        report.skip(path, "node is not installed: not validated by the Khronos validator")
    else:
        if run.returncode == 3:
            report.skip(path, f"not validated by the Khronos validator: {run.stdout.strip()}")
        else:
            require(run.returncode == 0, f"Khronos validator:\n{run.stdout}{run.stderr}")
            report.ok(path, "Khronos validator: " + run.stdout.strip().splitlines()[0].rsplit(": ", 1)[-1])
    meshes = glb_frames(Glb(path.read_bytes()))
    joints = 0
    for name, (faces, frames, colours, times) in meshes.items():
        for i, vertices in enumerate(frames):
            sound(vertices, faces, f"{name}, frame {i}")
        if expected is None:
            continue
        want = expected["meshes"][name]
        require(np.array_equal(faces, want["faces"]), f"{name}: other faces")
        require(len(frames) == len(want["frames"]), f"{name}: {len(frames)} frames, expected {len(want['frames'])}")
        # Single precision of joints, quaternions, weights and differences, through a chain of at most 12 joints within
        # 2 m: twenty roundings of 1.2e-7 each.
        for i, (got, wanted) in enumerate(zip(frames, want["frames"])):
            close(got, wanted, f"{name}, frame {i}", 20 * 1.2e-7 * 2)
        if times is not None:
            close(times, np.arange(len(frames)) / expected["fps"], f"{name}, times", 1e-6)
        if "colours" in want:
            close(colours[:, :3], linear(want["colours"]), f"{name}, colours", 0.51 / 65535)
    for skin in Glb(path.read_bytes()).json.get("skins", []):
        joints = max(joints, len(skin["joints"]))
    if expected is not None:
        require(set(meshes) == set(expected["meshes"]) - {"scan"}, f"meshes {sorted(meshes)}")
    counts = ", ".join(f"{name} {len(frames)}" for name, (_, frames, _, _) in meshes.items())
    report.ok(path, f"frames: {counts}; {joints} joints" + (" as expected" if expected else ""))


# ---------------------------------------------------------------------------------------------------------- USD


def check_usd(path, expected, report):
    try:
        from pxr import Usd, UsdGeom, UsdUtils
    except ImportError:
        report.skip(path, "not opened: pip install usd-core")
        return
    if hasattr(UsdUtils, "ComplianceChecker"):
        checker = UsdUtils.ComplianceChecker(arkit=False, skipARKitRootLayerCheck=True)
        checker.CheckCompliance(str(path))
        wrong = checker.GetErrors() + checker.GetFailedChecks()
        require(not wrong, f"compliance checker: {wrong}")
    stage = Usd.Stage.Open(str(path))
    require(stage is not None, "the stage does not open")
    require(UsdGeom.GetStageUpAxis(stage) == "Y", "up axis is not Y")
    require(UsdGeom.GetStageMetersPerUnit(stage) == 1.0, "units are not metres")
    root = stage.GetDefaultPrim()
    require(root and root.IsA(UsdGeom.Xform), "no Xform as default prim")
    start, end = int(stage.GetStartTimeCode()), int(stage.GetEndTimeCode())
    fps = stage.GetTimeCodesPerSecond()
    if expected is not None:
        require(fps == expected["fps"], f"{fps} time codes per second, expected {expected['fps']}")
    seen = {}
    for prim in Usd.PrimRange(root):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        require(prim.GetParent() == root, f"{prim.GetPath()} is not under the default prim")
        mesh = UsdGeom.Mesh(prim)
        name = prim.GetDisplayName() or prim.GetName()
        require(mesh.GetSubdivisionSchemeAttr().Get() == "none", f"{name}: is subdivided")
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
        ids = mesh.GetFaceVertexIndicesAttr().Get()
        require((counts == 3).all(), f"{name}: not all faces are triangles")
        times = mesh.GetPointsAttr().GetTimeSamples()
        codes = range(start, end + 1) if times else [start]
        if times:
            require(times == [float(c) for c in codes], f"{name}: time samples {times[:3]}…, stage {start} to {end}")
        want = expected["meshes"].get(name) if expected else None
        require(expected is None or want is not None, f"{name} is not expected")
        if want:
            require(np.array_equal(np.array(ids).reshape(-1, 3), want["faces"]), f"{name}: other faces")
            require(len(codes) == len(want["frames"]), f"{name}: {len(codes)} frames")
        for i, code in enumerate(codes):
            points = mesh.GetPointsAttr().Get(code)
            valid, why = UsdGeom.Mesh.ValidateTopology(ids, mesh.GetFaceVertexCountsAttr().Get(), len(points)), ""
            if isinstance(valid, tuple):
                valid, why = valid
            require(valid, f"{name}: topology: {why}")
            sound(points, np.array(ids).reshape(-1, 3), f"{name}, time {code}")
            extent = np.array(mesh.GetExtentAttr().Get(code))
            require(np.array_equal(extent, np.array(UsdGeom.PointBased.ComputeExtent(points))), f"{name}: extent at {code}")
            normals = mesh.GetNormalsAttr().Get(code)
            if normals is not None:
                require(mesh.GetNormalsInterpolation() == "vertex" and len(normals) == len(points), f"{name}: normals")
                p, f = np.array(points, float), np.array(ids).reshape(-1, 3)
                n = np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]])
                # The normals were made before the points were rounded to 32 bits: each side is known to sqrt(3) times a
                # unit in the last place, a cross product to that times both sides.
                last = np.sqrt(3.0) * 2.0**-23 * max(1e-3, float(np.abs(p).max()))
                sides = np.linalg.norm(p[f[:, 1]] - p[f[:, 0]], axis=1) + np.linalg.norm(p[f[:, 2]] - p[f[:, 0]], axis=1)
                summed, doubt = np.zeros_like(p), np.zeros(len(p))
                for k in range(3):
                    np.add.at(summed, f[:, k], n)
                    np.add.at(doubt, f[:, k], last * sides)
                length = np.linalg.norm(summed, axis=1)
                # Where the triangles of a vertex nearly cancel, rounding decides.
                clear = length > 10.0 * doubt
                off = np.linalg.norm(np.array(normals)[clear] - summed[clear] / length[clear, None], axis=1)
                worst = float((off - 2.0 * doubt[clear] / length[clear]).max(initial=0.0))
                require(worst < 1e-6, f"{name}, normals at {code}: {worst:.3g} beyond rounding")
            if want:
                # Seven digits or more are written: the same 32-bit number comes back.
                require(np.array_equal(np.array(points), single(want["frames"][i])), f"{name}, time {code}: other points")
        api = UsdGeom.PrimvarsAPI(prim)
        if want and "corner_uvs" in want:
            st = api.GetPrimvar("st")
            require(st and st.GetInterpolation() == "faceVarying", f"{name}: no st per corner")
            got = np.array(st.ComputeFlattened()).reshape(-1, 3, 2)
            require(np.array_equal(got, single(want["corner_uvs"])), f"{name}: other texture coordinates")
        colour = mesh.GetDisplayColorPrimvar()
        require(colour and colour.GetInterpolation() in ("constant", "vertex"), f"{name}: no displayColor")
        if want and "colours" in want:
            close(np.array(colour.Get()), linear(want["colours"]), f"{name}, colours", 1e-6)
        seen[name] = len(codes)
    require(seen, "no meshes")
    if expected is not None:
        require(set(seen) == set(expected["meshes"]) - {"scan"}, f"meshes {sorted(seen)}")
    counts = ", ".join(f"{name} {n}" for name, n in seen.items())
    report.ok(path, f"usd-core: frames: {counts}; {fps} per second" + (" as expected" if expected else ""))


# ------------------------------------------------------------------------------------------------- OBJ, PC2, PLY


def check_obj_sequence(paths, expected, report):
    folder = paths[0].parent
    try:
        import PIL  # noqa: F401  trimesh reads texture coordinates with it
        import trimesh
    except ImportError:
        report.skip(folder, "not read: pip install trimesh pillow")
        return
    numbers = [int(re.search(r"(\d+)$", p.stem).group(1)) for p in paths]
    require(numbers == list(range(1, len(paths) + 1)), f"frames {numbers[:3]}… are not 1, 2, …")
    want = expected["meshes"].get(folder.name) if expected else None
    faces = None
    for i, path in enumerate(paths):
        # Without textures each vertex stays one; with them it is split along seams, so corners are compared.
        mesh = trimesh.load(str(path), process=False, maintain_order=True, skip_texture=True, force="mesh")
        sound(mesh.vertices, mesh.faces, path.name)
        require(faces is None or np.array_equal(faces, mesh.faces), f"{path.name}: other faces than the frame before")
        faces = mesh.faces
        if not want:
            continue
        textured = trimesh.load(str(path), process=False, force="mesh")
        corners = np.asarray(want["frames"][i])[np.asarray(want["faces"])]
        close(np.asarray(textured.vertices)[textured.faces], corners, f"{path.name}, corners", 0.6e-8)
        if "corner_uvs" in want:
            uv = getattr(textured.visual, "uv", None)
            require(uv is not None, f"{path.name}: no texture coordinates")
            close(np.asarray(uv)[textured.faces], want["corner_uvs"], f"{path.name}, texture coordinates", 0.6e-8)
        if "colours" in want:
            # trimesh drops colours beside textures: columns 4 to 6 of the vertex lines.
            lines = [line.split() for line in path.read_text().splitlines() if line.startswith("v ")]
            got = np.array([[float(c) for c in line[4:7]] for line in lines])
            close(got * 255, want["colours"], f"{path.name}, colours", 0.02)
    if want:
        require(len(paths) == len(want["frames"]), f"{len(paths)} files, expected {len(want['frames'])}")
    report.ok(folder, f"trimesh: {len(paths)} frames" + (" as expected" if want else ""))


def check_pc2(path, expected, report):
    data = path.read_bytes()
    require(len(data) >= 32, "shorter than a header")
    magic, version, points, start, step, samples = struct.unpack("<12siiffi", data[:32])
    require(magic == b"POINTCACHE2\0" and version == 1, f"no point cache of version 1: {magic}, {version}")
    require(points > 0 and samples > 0 and step > 0 and np.isfinite(start), f"{points} points, {samples} samples, step {step}")
    require(len(data) == 32 + samples * points * 12, f"{len(data)} bytes for {samples} samples of {points} points")
    frames = np.frombuffer(data, "<f4", offset=32).reshape(samples, points, 3)
    require(np.isfinite(frames).all(), "positions that are not finite")
    want = expected["meshes"].get(path.stem) if expected else None
    if want:
        require(np.array_equal(frames, single(want["frames"])), "other positions than expected")
    report.ok(path, f"numpy: {samples} samples of {points} points" + (" as expected" if want else ""))


def check_ply(path, expected, report):
    want = expected["meshes"].get(path.stem) if expected else None
    try:
        import trimesh

        mesh = trimesh.load(str(path), process=False)
        faces = getattr(mesh, "faces", np.zeros((0, 3), int))
        sound(mesh.vertices, faces, "trimesh")
        if want:
            require(np.array_equal(np.asarray(mesh.vertices, np.float32), single(want["frames"][0])), "trimesh: positions")
            require(np.array_equal(faces, want["faces"]), "trimesh: faces")
            require(np.array_equal(mesh.visual.vertex_colors[:, :3], want["colours"]), "trimesh: colours")
        report.ok(path, f"trimesh: {len(mesh.vertices)} vertices, {len(faces)} faces" + (" as expected" if want else ""))
    except ImportError:
        report.skip(path, "not read by trimesh: pip install trimesh")
    try:
        import plyfile

        ply = plyfile.PlyData.read(str(path))
        vertex = ply["vertex"]
        got = np.stack([vertex["x"], vertex["y"], vertex["z"]], 1)
        require(np.isfinite(got).all(), "plyfile: positions that are not finite")
        if want:
            require(np.array_equal(got, single(want["frames"][0])), "plyfile: positions")
            require(np.array_equal(np.stack(ply["face"]["vertex_indices"]), want["faces"]), "plyfile: faces")
            colours = np.stack([vertex["red"], vertex["green"], vertex["blue"]], 1)
            require(np.array_equal(colours, want["colours"]), "plyfile: colours")
        report.ok(path, f"plyfile: {len(got)} vertices" + (" as expected" if want else ""))
    except ImportError:
        report.skip(path, "not read by plyfile: pip install plyfile")


def main():
    arguments = [a for a in sys.argv[1:] if a != "--require-all"]
    if len(arguments) != 1 or not Path(arguments[0]).is_dir():
        print(__doc__)
        return 2
    folder = Path(arguments[0])
    report = Report()
    if np is None:
        print("SKIPPED everything: pip install numpy")
        return 1 if "--require-all" in sys.argv else 0
    truth = folder / "expected.json"
    expected = json.loads(truth.read_text()) if truth.exists() else None
    if expected is None:
        print(f"{folder} holds no expected.json: files are read and validated, not compared")

    sequences = {}
    for path in sorted(folder.rglob("frame_*.obj")):
        sequences.setdefault(path.parent, []).append(path)
    tasks = [(check_glb, p) for p in sorted(folder.rglob("*.glb"))]
    tasks += [(check_usd, p) for p in sorted(folder.rglob("*.usda"))]
    tasks += [(check_obj_sequence, paths) for paths in sequences.values()]
    tasks += [(check_pc2, p) for p in sorted(folder.rglob("*.pc2"))]
    tasks += [(check_ply, p) for p in sorted(folder.rglob("*.ply"))]
    for check, what in tasks:
        try:
            check(what, expected, report)
        except Wrong as wrong:
            report.fail(what if isinstance(what, Path) else what[0].parent, wrong)
        except Exception as error:  # A reader that cannot read the file: whatever it raises is the finding.
            report.fail(what if isinstance(what, Path) else what[0].parent, f"{type(error).__name__}: {error}")
    if expected is not None:
        kinds = {check.__name__ for check, _ in tasks}
        for kind in ("check_glb", "check_usd", "check_obj_sequence", "check_pc2", "check_ply"):
            if kind not in kinds:
                report.fail(folder, f"no file for {kind}")
    print(f"{len(report.checked)} checks passed, {len(report.failed)} failed, {len(report.skipped)} SKIPPED")
    if not tasks:
        print("FAILED: nothing to check")
    return 1 if report.failed or not tasks or (report.skipped and "--require-all" in sys.argv) else 0


if __name__ == "__main__":
    sys.exit(main())
