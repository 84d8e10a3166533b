#!/usr/bin/env python3
"""Writes small valid files of every format into corpus/<target>/: what the fuzzer starts from. Standard library only."""
import io
import json
import pathlib
import struct
import zipfile

ROOT = pathlib.Path(__file__).parent / "corpus"


def put(target, name, content):
    folder = ROOT / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def npy(descr, shape, data, fortran=False, version=1):
    header = f"{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n".encode()
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header + data


def archive(entries, method=zipfile.ZIP_STORED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as z:
        for name, content in entries.items():
            z.writestr(zipfile.ZipInfo(f"{name}.npy"), content, method)
    return buffer.getvalue()


def obj():
    cube = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    put("obj", "quads", "# cube\nmtllib a.mtl\no cube\n" + cube + "g side\ns off\nf 1 2 4 3\nf -4 -2 -1 -3\n")
    put("obj", "full", cube.replace("\n", " 1 0.5 0\n") + "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nusemtl m\n"
        "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 2/2/1 \\\n 4/3/1 3/1/1\n")
    put("obj", "normals", cube.replace("\n", "\r\n") + "vn 0 1e-3 -1.5E+2\r\nf 1//1 2//1 3//-1\r\nl 1 2\r\np 1\r\n")
    put("obj", "bytes", cube.replace("\n", " 255 128 0 1\n") + "f 1 2 3 5 8 7 6\nfo 1 2 3\ncstype bezier\n")
    put("obj", "concave", "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 2 1 0\nv 0 3 0\nf 1 2 3 4 5\n\ng a b\nf 1 2 4\n")


def ply():
    head = "ply\nformat {} 1.0\ncomment c\nobj_info o\nelement vertex 4\nproperty float x\nproperty float y\n" \
        "property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty int8 label\n" \
        "element face 2\nproperty list uchar int vertex_indices\nproperty ushort flags\nend_header\n"
    rows = [(0, 0, 0, 1, 2, 3, 0), (1, 0, 0, 4, 5, 6, 1), (1, 1, 0, 7, 8, 9, 2), (0, 1, 0, 0, 255, 0, -1)]
    put("ply", "ascii", head.format("ascii") + "".join(" ".join(map(str, r)) + "\n" for r in rows)
        + "4 0 1 2 3 7\n3 0 1 2 8\n")
    for order, sign in (("little", "<"), ("big", ">")):
        body = b"".join(struct.pack(sign + "ffdBBBb", *r) for r in rows)
        body += struct.pack(sign + "BiiiiHBiiiH", 4, 0, 1, 2, 3, 7, 3, 0, 1, 2, 8)
        put("ply", order, head.format(f"binary_{order}_endian").encode() + body)
    put("ply", "strips", "ply\r\nformat ascii 1.0\r\nelement tristrips 1\r\nproperty list int int vertex_indices\r\n"
        "element vertex 4\r\nproperty float x\r\nproperty float y\r\nproperty float z\r\nproperty float red\r\n"
        "property float green\r\nproperty float blue\r\nproperty list uint8 float32 extra\r\nend_header\r\n"
        "6 0 1 2 3 -1 0\r\n" + "0 0.5 1e-3 1 0.5 0 2 1 2\r\n" * 4)


def npz():
    f8 = struct.pack("<6d", *range(6))
    entries = {
        "a": npy("<f8", "(2, 3)", f8), "b": npy(">f4", "(3, 2)", struct.pack(">6f", *range(6)), True),
        "c": npy("<i8", "()", struct.pack("<q", -5)), "d": npy("|b1", "(4,)", b"\0\1\1\0", version=2),
        "e": npy("<U2", "(2,)", "abcd".encode("utf-32-le")), "f": npy("|S3", "(1,)", b"xyz"),
        "g": npy("<f2", "(2,)", b"\x00\x3c\x00\x7c"), "h": npy("<u4", "(0, 3)", b""),
    }
    put("npz", "stored", b"\0" + archive(entries))
    put("npz", "deflated", b"\0" + archive(entries, zipfile.ZIP_DEFLATED))
    put("npz", "zeros", b"\0" + archive({"a": npy("<f8", "(1000,)", bytes(8000))}, zipfile.ZIP_DEFLATED))
    put("npz", "pickle", b"\0\x80\x04\x95")
    for name, content in entries.items():
        put("npz", f"entry-{name}", b"\1" + content)


def smpl_npz():
    def floats(rows, width, matrices=False):
        identity = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
        values = [identity[i % 9] if matrices else 0.001 * i for i in range(rows * width)]
        return struct.pack(f"<{rows * width}f", *values)

    trans = npy("<f8", "(2, 3)", struct.pack("<6d", *range(6)))
    rate = npy("<f8", "()", struct.pack("<d", 120.0))
    for mode, width in ((4, 165), (7, 156), (12, 72), (13, 66)):
        poses = npy("<f4", f"(2, {width})", floats(2, width))
        put("smpl_npz", f"entries-{width}", bytes([mode]) + b"\n--\n".join([poses, trans, rate]))
    archived = {"poses": npy("<f4", "(2, 165)", floats(2, 165)), "trans": trans, "mocap_framerate": rate}
    put("smpl_npz", "archive", b"\1" + archive(archived, zipfile.ZIP_DEFLATED))
    parts = [npy("<f4", "(2, 3)", floats(2, 3)), npy("<f4", "(2, 63)", floats(2, 63)), trans, rate,
             npy("<f4", "(2, 90)", floats(2, 90)), npy("<f4", "(2, 3)", floats(2, 3))]
    put("smpl_npz", "parts", bytes([20]) + b"\n--\n".join(parts))
    matrices = [npy("<f4", "(2, 1, 3, 3)", floats(2, 9, True)), npy("<f4", "(2, 21, 3, 3)", floats(2, 189, True)), trans,
                rate]
    put("smpl_npz", "matrices", bytes([30]) + b"\n--\n".join(matrices))


def asf_amc():
    bones = "lfemur rfemur lowerback ltibia rtibia upperback lfoot rfoot thorax ltoes rtoes upperneck lclavicle " \
        "rclavicle head lhumerus rhumerus lradius rradius lhand rhand".split()
    asf = ":version 1.10\n:units\nlength 0.45\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\nposition 0 0 0\n" \
        "orientation 0 0 0\n:bonedata\n"
    for bone in bones:
        asf += f"begin\nname {bone}\ndirection 0 -1 0\nlength 1\naxis 0 0 20 XYZ\ndof rx rz\nend\n"
    asf += ":hierarchy\nbegin\nroot " + " ".join(bones[:3]) + "\nlfemur ltibia\nrfemur rtibia\nlowerback " \
        + " ".join(bones[5:]) + "\nend\n"
    frame = "root 1 2 3 4 5 6\nlfemur 10 20\nltibia 1.5 -2.5e1\n"
    put("asf_amc", "walk", asf.encode() + b"\0" + f"#!OML\n:DEGREES\n1\n{frame}2\n{frame}".encode())


def bvh():
    head = "HIERARCHY\nROOT a\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation " \
        "Xrotation\n JOINT b\n {\n  OFFSET 3.5 0 -1e1\n  CHANNELS 3 Zrotation Yrotation Xrotation\n  JOINT c\n  {\n" \
        "   OFFSET 0 0 -40\n   CHANNELS 1 Xrotation\n   End Site\n   {\n    OFFSET 0 1 -40\n   }\n  }\n }\n}\n"
    rows = "1 2 90 0 10 0 5 -6.5 7 8\n1 2 91 0 11 0 5 6 7 9\n"
    put("bvh", "two", head + "MOTION\nFrames: 2\nFrame Time: 0.0083333\n" + rows)
    put("bvh", "one", (head + "MOTION\nFrames:1\nFrame Time:1e-2\n" + rows[:25]).replace("\n", "\r\n"))


def safetensors():
    header = json.dumps({
        "__metadata__": {"type": "gru", "layers": "4"},
        "w": {"dtype": "F32", "shape": [2, 2], "data_offsets": [0, 16]},
        "b": {"dtype": "F64", "shape": [1], "data_offsets": [16, 24]},
    }).encode()
    put("safetensors", "two", struct.pack("<Q", len(header)) + header + struct.pack("<4fd", 1, 2, 3, 4, 5))
    put("safetensors", "empty", struct.pack("<Q", 2) + b"{}")


for write in (obj, ply, npz, smpl_npz, asf_amc, bvh, safetensors):
    write()
