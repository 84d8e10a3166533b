//! Damage to a valid file of every format: cut off at every byte, bytes changed at every place. A reader answers with
//! an error that names the file or with what is left; it never panics.

mod support;

use caphy_core::motion::MotionClip;
use caphy_core::scan::{Label, Scan};
use caphy_core::{Result, TriMesh, Vec3};
use caphy_formats::motion::{
    SkeletonMapping, SmplNpzOptions, TranslationMeaning, read_asf_amc, read_bvh, read_smpl_npz,
};
use caphy_formats::npz::Npz;
use caphy_formats::obj::{read_obj, write_obj};
use caphy_formats::ply::{read_ply, write_ply};
use caphy_formats::weights::{read_safetensors, read_safetensors_metadata, write_safetensors};
use std::path::Path;

/// How many of the damaged files were refused, how many were still read.
#[derive(Debug, Default)]
struct Tally {
    refused: usize,
    read: usize,
}

/// Reads damaged copies; every refusal must name the file.
struct Damage<'a, T> {
    file: &'a str,
    whole: &'a [u8],
    read: &'a dyn Fn(&[u8]) -> Result<T>,
}

impl<T> Damage<'_, T> {
    fn try_one(&self, bytes: &[u8], what: &dyn Fn() -> String, tally: &mut Tally) {
        match (self.read)(bytes) {
            Ok(_) => tally.read += 1,
            Err(e) => {
                let text = e.to_string();
                assert!(text.contains(self.file), "{}: does not name `{}`: {text}", what(), self.file);
                assert!(text.len() < 2000, "{}: {} bytes of message", what(), text.len());
                tally.refused += 1;
            }
        }
    }
    /// Cut off after every number of bytes below the whole.
    fn cuts(&self) -> Tally {
        assert!((self.read)(self.whole).is_ok(), "{}: the whole file must be read", self.file);
        let mut tally = Tally::default();
        for cut in 0..self.whole.len() {
            self.try_one(&self.whole[..cut], &|| format!("cut at {cut}"), &mut tally);
        }
        tally
    }
    /// Each byte changed: a bit flipped, zero, all ones, and what means something in text.
    fn changes(&self) -> Tally {
        let mut tally = Tally::default();
        for place in 0..self.whole.len() {
            let old = self.whole[place];
            let bits = (0..8).map(|bit| old ^ (1 << bit));
            for new in bits.chain([0, 0xff, b' ', b'\n', b'9', b'-', b'e', b'/', b'\\', b'#', b'{', b'"']) {
                let mut bad = self.whole.to_vec();
                bad[place] = new;
                self.try_one(&bad, &|| format!("byte {place} from {old} to {new}"), &mut tally);
            }
            let mut short = self.whole.to_vec();
            short.remove(place);
            self.try_one(&short, &|| format!("without byte {place}"), &mut tally);
            let mut long = self.whole.to_vec();
            long.insert(place, old);
            self.try_one(&long, &|| format!("byte {place} twice"), &mut tally);
        }
        tally
    }
    /// Both; returns the cuts.
    fn all(&self) -> Tally {
        let (cuts, changes) = (self.cuts(), self.changes());
        println!("{}: cut {cuts:?}, changed {changes:?}", self.file);
        assert!(changes.refused > 0);
        cuts
    }
}

fn tetrahedron() -> Scan {
    let p = |x, y, z| Vec3::new(x, y, z);
    let vertices = vec![p(0.0, 0.0, 0.0), p(1.0, 0.0, 0.0), p(0.0, 1.5, 0.0), p(0.25, 0.0, -1.0)];
    Scan {
        name: "scan".into(),
        mesh: TriMesh::new("t", vertices, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).unwrap(),
        colours: Some(vec![[1, 2, 3], [255, 0, 7], [9, 8, 7], [0, 0, 0]]),
        labels: Some(vec![Label::Body, Label::Upper, Label::Lower, Label::Ignore]),
    }
}

/// What is read is whole, too.
fn checked_ply(bytes: &[u8]) -> Result<Scan> {
    let scan = read_ply(Path::new("p/scan.ply"), bytes)?;
    scan.mesh.check("scan").unwrap();
    assert!(scan.colours.as_ref().is_none_or(|c| c.len() == scan.mesh.vertices.len()));
    Ok(scan)
}

#[test]
fn ply() {
    let ascii = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty float y\nproperty float z\n\
        property list uchar float extra\nelement face 1\nproperty list uchar int vertex_index\nelement tristrips 1\n\
        property list int int vertex_indices\nend_header\n0 0 0 1 5\n1 0 0 0\n-1 0.5 1e-3 2 1 2\n3 0 1 2\n5 0 1 -1 2 0 \n";
    let binary = write_ply(&tetrahedron());
    let big = {
        let mut bytes =
            b"ply\nformat binary_big_endian 1.0\nelement face 1\nproperty list ushort uint vertex_indices\n\
            element vertex 3\nproperty double x\nproperty short y\nproperty float z\nend_header\n"
                .to_vec();
        bytes.extend([0, 3, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2]);
        for (x, y, z) in [(0.5f64, 1i16, 2f32), (1.0, 0, 0.0), (0.0, 1, 0.0)] {
            bytes.extend(x.to_be_bytes());
            bytes.extend(y.to_be_bytes());
            bytes.extend(z.to_be_bytes());
        }
        bytes
    };
    for (whole, ends_in_blank) in [(ascii.as_bytes(), true), (&binary, false), (&big, false)] {
        let cuts = Damage { file: "scan.ply", whole, read: &checked_ply }.all();
        // The text ends with a blank and a line feed that no number needs.
        assert_eq!(cuts.read, if ends_in_blank { 2 } else { 0 });
    }
}

#[test]
fn obj() {
    let text = "# a side\nmtllib a b.mtl\no side of a cube\nv 0 0 0 1 0 0.5\nv 1 0 0 1 0 0.5\nv 1 1 0 1 0 0.5\n\
        v 0 1 0 1 0 0.5\nv .5 -1e-1 0 1 0 0.5\r\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\ng one two\ns 1\n\
        f 1/1/1 2/2/1 \\\n3/3/1 4/1/1\nf -4/3/-1 -3/2/-1 -2/3/-1\nl 1 2\n";
    let read = |bytes: &[u8]| {
        let mesh = read_obj(Path::new("scan.obj"), bytes)?;
        mesh.scan.mesh.check("scan").unwrap();
        for (count, faces) in [
            mesh.uvs.as_ref().map(|u| (u.coords.len(), &u.faces)),
            mesh.normals.as_ref().map(|n| (n.vectors.len(), &n.faces)),
        ]
        .into_iter()
        .flatten()
        {
            assert_eq!(faces.len(), mesh.scan.mesh.faces.len());
            assert!(faces.iter().flatten().all(|&id| (id as usize) < count));
        }
        assert!(mesh.groups.iter().all(|g| g.faces.end <= mesh.scan.mesh.faces.len()));
        Ok(mesh)
    };
    Damage { file: "scan.obj", whole: text.as_bytes(), read: &read }.all();
    let scan = tetrahedron();
    let written = write_obj(&scan.mesh, scan.colours.as_deref()).unwrap();
    let cuts = Damage { file: "scan.obj", whole: &written, read: &read }.all();
    assert!(cuts.refused > written.len() / 10);
}

/// Every array of an archive in every way.
fn every_array(bytes: &[u8]) -> Result<()> {
    let npz = Npz::from_bytes(Path::new("body.npz"), bytes.to_vec())?;
    let mut last = Ok(());
    for name in npz.names() {
        let numbers = npz.f64s(name).map(|a| assert_eq!(a.shape.iter().product::<usize>(), a.data.len()));
        let texts = npz.strings(name).map(|_| ());
        let _ = (npz.f32s(name), npz.i64s(name), npz.finite_f64s(name), npz.f64_scalar(name));
        if let (Err(_), Err(e)) = (numbers, texts) {
            last = Err(e);
        }
    }
    last
}

#[test]
fn npz() {
    let body = [1.5f64, f64::NAN, -2.0, 0.0, 1e-3, 7.0].iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let entries = [
        ("a", support::npy("<f8", true, "(2, 3)", &body)),
        ("names", support::npy("<U2", false, "(2,)", &[97, 0, 0, 0, 98, 0, 0, 0, 99, 0, 0, 0, 0, 0, 0, 0])),
    ];
    for deflated in [false, true] {
        let whole = support::archive(&entries, deflated);
        let cuts = Damage { file: "body.npz", whole: &whole, read: &every_array }.all();
        assert_eq!(cuts.read, 0, "the directory stands last");
    }
}

/// A clip in AMASS's layout.
fn read_amass(bytes: Vec<u8>, pelvis: &Vec3) -> Result<MotionClip> {
    read_smpl_npz(Path::new("clip.npz"), bytes, &SmplNpzOptions::amass(TranslationMeaning::PelvisPosition), pelvis)
}

#[test]
fn amass() {
    let floats = |n: usize| (0..n).flat_map(|i| (1e-3 * i as f32).to_le_bytes()).collect::<Vec<u8>>();
    let entries = [
        ("poses", support::npy("<f4", false, "(1, 156)", &floats(156))),
        ("trans", support::npy("<f4", false, "(1, 3)", &floats(3))),
        ("mocap_framerate", support::npy("<f8", false, "()", &120f64.to_le_bytes())),
    ];
    let read = |bytes: &[u8]| read_amass(bytes.to_vec(), &Vec3::zeros());
    for deflated in [false, true] {
        let whole = support::archive(&entries, deflated);
        let cuts = Damage { file: "clip.npz", whole: &whole, read: &read }.all();
        assert_eq!(cuts.read, 0);
    }
}

#[test]
fn asf_and_amc() {
    let bones = "lfemur rfemur lowerback ltibia rtibia upperback lfoot rfoot thorax ltoes rtoes upperneck lclavicle \
        rclavicle head lhumerus rhumerus lradius rradius lhand rhand";
    let mut asf = ":version 1.10\n:units\nlength 0.45\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\n\
        position 0 0 0\norientation 0 0 0\n:bonedata\n"
        .to_string();
    for bone in bones.split_whitespace() {
        asf += &format!("begin\nname {bone}\ndirection 0 1 0\nlength 1\naxis 0 0 20 XYZ\ndof rx rz\nend\n");
    }
    asf += &format!(":hierarchy\nbegin\nroot {bones}\nend\n");
    let frame = "root 1 2 3 4 5 6\nlfemur 10 20\nltibia 1.5 2.5\n";
    let amc = format!("#!OML:ASF\n:FULLY-SPECIFIED\n:DEGREES\n1\n{frame}2\n{frame}");
    let mapping = SkeletonMapping::cmu_asf().unwrap();
    let read = |asf: &[u8], amc: &[u8]| {
        read_asf_amc(Path::new("clip.asf"), asf, Path::new("clip.amc"), amc, 120.0, &mapping, &Vec3::zeros())
    };
    // Damage to one may show in the other: the names differ in the ending alone.
    let skeleton = |bytes: &[u8]| read(bytes, amc.as_bytes());
    Damage { file: "clip.a", whole: asf.as_bytes(), read: &skeleton }.all();
    let frames = |bytes: &[u8]| read(asf.as_bytes(), bytes);
    Damage { file: "clip.amc", whole: amc.as_bytes(), read: &frames }.all();
}

#[test]
fn bvh() {
    let mapping = SkeletonMapping::from_toml(
        Path::new("two.toml"),
        b"metres_per_unit = 0.01\n[joints]\nHips = \"pelvis\"\nLeftUpLeg = \"left_hip\"\n",
    );
    let mapping = mapping.unwrap();
    let text = "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation \
        Xrotation\n JOINT LeftUpLeg\n {\n  OFFSET 3.5 -1e1 0\n  CHANNELS 3 Zrotation Yrotation Xrotation\n  End Site\n  {\n   \
        OFFSET 0 -40 0\n  }\n }\n}\nMOTION\nFrames: 2\nFrame Time: 0.0083333\n1 90 2 0 10 0 5 -6.5 7\n\
        1 90 3 0 11 0 5 6 7\n";
    let read = |bytes: &[u8]| read_bvh(Path::new("clip.bvh"), bytes, &mapping, &Vec3::zeros());
    let cuts = Damage { file: "clip.bvh", whole: text.as_bytes(), read: &read }.all();
    // Without its last digit and line feed, or the line feed alone, the last number is none or the same.
    assert_eq!(cuts.read, 1);
    for (from, to) in [("-1e1", "1e308"), ("1 90 2", "1e308 1e308 1e308"), ("0.0083333", "5e-324")] {
        assert!(text.contains(from));
        if let Err(e) = read(text.replacen(from, to, 1).as_bytes()) {
            assert!(e.to_string().contains("clip.bvh"), "{e}");
        }
    }
}

#[test]
fn numbers_that_overflow_are_errors_of_the_file() {
    let huge = 1e308f64;
    let mut poses = vec![0.0; 156];
    poses[..3].fill(huge);
    let bytes = |x: &[f64]| x.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let entries = [
        ("poses", support::npy("<f8", false, "(1, 156)", &bytes(&poses))),
        ("trans", support::npy("<f8", false, "(1, 3)", &bytes(&[huge; 3]))),
        ("mocap_framerate", support::npy("<f8", false, "()", &120f64.to_le_bytes())),
    ];
    let pelvis = Vec3::new(-huge, -huge, -huge);
    let text = read_amass(support::archive(&entries, false), &pelvis).unwrap_err().to_string();
    assert!(text.contains("clip.npz") && text.contains("frame 0"), "{text}");
}

#[test]
fn safetensors() {
    let metadata = [("type".to_string(), "gru".to_string()), ("note".into(), "quotes \" and ü".into())].into();
    let whole = write_safetensors(&[("w", &[2, 3], &[0.5; 6]), ("b", &[1], &[1.0]), ("none", &[0, 4], &[])], &metadata);
    let read = |bytes: &[u8]| {
        let file = Path::new("net.safetensors");
        let tensors = read_safetensors(file, bytes)?;
        assert!(tensors.iter().all(|(_, shape, values)| shape.iter().product::<usize>() == values.len()));
        read_safetensors_metadata(file, bytes)
    };
    let cuts = Damage { file: "net.safetensors", whole: &whole.unwrap(), read: &read }.all();
    assert_eq!(cuts.read, 0);
}
