#!/usr/bin/env python3
"""Scans of 4D-DRESS or X-Humans as PLY files that caphy reads: pickled_to_ply.py TAKE_FOLDER OUT [EVERY_NTH]

TAKE_FOLDER holds Meshes_pkl (or meshes_pkl), perhaps Semantic/labels and SMPLX. Writes OUT/NAME.ply with colours and, where there are
some, labels, and OUT/starts.npz with the fitted poses for `subject.starts`. Pickles can run code: open only those that you trust.
"""
import pathlib
import pickle
import sys

import numpy as np

# skin, hair, shoe: body; upper; lower; outer: upper.
LABELS = np.array([0, 0, 0, 1, 2, 1], np.uint8)
# Pose arrays of SMPL-X in the order of its joints, with the numbers of joints.
PARTS = [
    ("global_orient", 1), ("body_pose", 21), ("jaw_pose", 1), ("leye_pose", 1), ("reye_pose", 1),
    ("left_hand_pose", 15), ("right_hand_pose", 15),
]


def load(path):
    with open(path, "rb") as file:
        return pickle.load(file, encoding="latin1")


def colours(mesh, texture):
    """sRGB per vertex from the texture (u right, v up), or those stored."""
    if texture is not None and mesh.get("uvs") is not None and len(mesh["uvs"]) == len(mesh["vertices"]):
        image = np.asarray(texture)
        uv = np.asarray(mesh["uvs"], float)
        x = np.clip((uv[:, 0] * image.shape[1]).astype(int), 0, image.shape[1] - 1)
        y = np.clip(((1 - uv[:, 1]) * image.shape[0]).astype(int), 0, image.shape[0] - 1)
        return image[y, x, :3].astype(np.uint8)
    stored = mesh.get("colors")
    if stored is None:
        return None
    stored = np.asarray(stored)[:, :3]
    return (stored * 255).round().astype(np.uint8) if stored.max() <= 1 else stored.astype(np.uint8)


def write_ply(path, vertices, faces, colour, label):
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    if colour is not None:
        fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    if label is not None:
        fields += [("label", "u1")]
        header += ["property uchar label"]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    points = np.zeros(len(vertices), fields)
    for k, axis in enumerate("xyz"):
        points[axis] = vertices[:, k]
    for k, name in enumerate(("red", "green", "blue") if colour is not None else ()):
        points[name] = colour[:, k]
    if label is not None:
        points["label"] = label
    corners = np.zeros(len(faces), [("n", "u1"), ("ids", "<i4", 3)])
    corners["n"], corners["ids"] = 3, faces
    path.write_bytes("\n".join(header).encode() + b"\n" + points.tobytes() + corners.tobytes())


def full_pose(fit):
    """(55, 3) axis-angle, or None where hands are principal components."""
    parts = []
    for name, joints in PARTS:
        values = np.asarray(fit.get(name, np.zeros(3 * joints)), float).reshape(-1)
        if values.size != 3 * joints:
            if "hand" not in name:
                return None
            values = np.zeros(3 * joints)
        parts.append(values.reshape(joints, 3))
    return np.concatenate(parts)


def main(take, out, every=1):
    take, out = pathlib.Path(take), pathlib.Path(out)
    meshes = next((take / name for name in ("Meshes_pkl", "meshes_pkl") if (take / name).is_dir()), None)
    if meshes is None:
        sys.exit(f"{take} holds neither Meshes_pkl nor meshes_pkl")
    out.mkdir(parents=True, exist_ok=True)
    starts = {}
    for path in sorted(meshes.glob("mesh-f*.pkl"))[::every]:
        frame = path.stem.split("-")[1]
        name = f"{take.name}-{frame}"
        mesh = load(path)
        atlas = meshes / f"atlas-{frame}.pkl"
        labels = take / "Semantic" / "labels" / f"label-{frame}.pkl"
        label = None
        if labels.exists():
            label = LABELS[np.asarray(load(labels)["scan_labels"]).astype(int).reshape(-1)]
        vertices, faces = np.asarray(mesh["vertices"], float), np.asarray(mesh["faces"], int)
        colour = colours(mesh, load(atlas) if atlas.exists() else None)
        write_ply(out / f"{name}.ply", vertices, faces, colour, label)
        fit = take / "SMPLX" / f"mesh-{frame}_smplx.pkl"
        if fit.exists():
            fit = load(fit)
            pose = full_pose(fit)
            if pose is not None:
                starts[f"{name}__full_pose"] = pose
                # What SMPL-X adds after posing, as caphy does.
                starts[f"{name}__translation"] = np.asarray(fit.get("transl", np.zeros(3)), float).reshape(3)
        print(name, len(vertices), "vertices", "" if label is None else "with labels")
    if starts:
        np.savez(out / "starts.npz", **starts)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]) if len(sys.argv) == 4 else 1)
