//! Archives made to deceive: bombs, entries that share bytes, sizes that lie. Refused before memory is taken.

mod support;

use caphy_formats::npz::Npz;
use flate2::Crc;
use flate2::write::DeflateEncoder;
use std::io::Write;
use std::path::Path;
use support::npy;

/// An entry as the directory and its own header describe it, and the bytes that are really there.
#[derive(Clone)]
struct Entry {
    name: &'static str,
    own_name: &'static str,
    flags: u16,
    method: u16,
    crc: u32,
    compressed: u64,
    size: u64,
    packed: Vec<u8>,
    /// In place of the place where it stands.
    offset: Option<u64>,
}

fn crc(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// An honest entry.
fn entry(name: &'static str, content: &[u8], deflated: bool) -> Entry {
    let packed = if deflated {
        let mut encoder = DeflateEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(content).unwrap();
        encoder.finish().unwrap()
    } else {
        content.to_vec()
    };
    Entry {
        name,
        own_name: name,
        flags: 0,
        method: if deflated { 8 } else { 0 },
        crc: crc(content),
        compressed: packed.len() as u64,
        size: content.len() as u64,
        packed,
        offset: None,
    }
}

fn put(out: &mut Vec<u8>, numbers: &[(u64, usize)]) {
    for &(value, bytes) in numbers {
        out.extend(&value.to_le_bytes()[..bytes]);
    }
}

/// The archive; with ZIP64 records as `numpy.savez` writes them for large files when `wide`.
fn zip(entries: &[Entry], wide: bool, announced: Option<u64>) -> Vec<u8> {
    let full = u64::from(u32::MAX);
    let mut out = Vec::new();
    let mut directory = Vec::new();
    for e in entries {
        let offset = e.offset.unwrap_or(out.len() as u64);
        let narrow = |x: u64| if wide { full } else { x };
        let crc = u64::from(e.crc);
        let method = (u64::from(e.flags), u64::from(e.method));
        out.extend(b"PK\x03\x04");
        put(&mut out, &[(45, 2), (method.0, 2), (method.1, 2), (0, 4), (crc, 4), (narrow(e.compressed), 4)]);
        put(&mut out, &[(narrow(e.size), 4), (e.own_name.len() as u64, 2), (if wide { 20 } else { 0 }, 2)]);
        out.extend(e.own_name.as_bytes());
        if wide {
            put(&mut out, &[(1, 2), (16, 2), (e.size, 8), (e.compressed, 8)]);
        }
        out.extend(&e.packed);
        directory.extend(b"PK\x01\x02");
        put(&mut directory, &[(45, 2), (45, 2), (method.0, 2), (method.1, 2), (0, 4), (crc, 4)]);
        put(&mut directory, &[(narrow(e.compressed), 4), (narrow(e.size), 4), (e.name.len() as u64, 2)]);
        // Another extra field first: it is passed over.
        put(
            &mut directory,
            &[(if wide { 4 + 1 + 28 } else { 0 }, 2), (0, 2), (0, 2), (0, 2), (0, 4), (narrow(offset), 4)],
        );
        directory.extend(e.name.as_bytes());
        if wide {
            put(
                &mut directory,
                &[(0xcafe, 2), (1, 2), (0, 1), (1, 2), (24, 2), (e.size, 8), (e.compressed, 8), (offset, 8)],
            );
        }
    }
    let (start, size) = (out.len() as u64, directory.len() as u64);
    let count = announced.unwrap_or(entries.len() as u64);
    out.extend(&directory);
    if wide {
        let at = out.len() as u64;
        out.extend(b"PK\x06\x06");
        put(&mut out, &[(44, 8), (45, 2), (45, 2), (0, 4), (0, 4), (count, 8), (count, 8), (size, 8), (start, 8)]);
        out.extend(b"PK\x06\x07");
        put(&mut out, &[(0, 4), (at, 8), (1, 4)]);
    }
    out.extend(b"PK\x05\x06");
    let (count, size, start) = if wide { (0xffff, full, full) } else { (count, size, start) };
    put(&mut out, &[(0, 2), (0, 2), (count, 2), (count, 2), (size, 4), (start, 4), (0, 2)]);
    out
}

fn open(bytes: Vec<u8>) -> caphy_core::Result<Npz> {
    Npz::from_bytes(Path::new("body.npz"), bytes)
}

fn refusal(bytes: Vec<u8>) -> String {
    let text = match open(bytes) {
        Err(e) => e.to_string(),
        Ok(npz) => npz.names().iter().find_map(|n| npz.f64s(n).err()).expect("refused").to_string(),
    };
    assert!(text.contains("body.npz"), "{text}");
    text
}

fn twelve() -> Vec<u8> {
    npy("<f8", false, "(12,)", &(0..12).flat_map(|i| f64::from(i).to_le_bytes()).collect::<Vec<u8>>())
}

#[test]
fn honest_archives_are_read_with_and_without_zip64() {
    for wide in [false, true] {
        for deflated in [false, true] {
            let entries =
                [entry("b.npy", &twelve(), deflated), entry("a.npy", &twelve(), deflated), entry("x.txt", b"", false)];
            let npz = open(zip(&entries, wide, None)).unwrap();
            assert_eq!(npz.names(), ["a", "b"]);
            assert_eq!(npz.f64s("b").unwrap().data[11], 11.0);
        }
    }
    assert!(open(zip(&[], false, None)).unwrap().names().is_empty());
    // A comment behind the directory.
    let mut commented = zip(&[entry("a.npy", &twelve(), true)], false, None);
    let length = commented.len();
    commented[length - 2] = 5;
    commented.extend(b"hello");
    assert_eq!(open(commented).unwrap().f64s("a").unwrap().shape, [12]);
}

#[test]
fn sizes_that_lie_are_refused_before_memory_is_taken() {
    let honest = || entry("a.npy", &twelve(), true);
    let billion = 1u64 << 30;
    // A header that needs as much as the directory says, so that only the bytes that are there contradict.
    let bomb = |shape: &str, size: u64, packed: usize| {
        let mut e = entry("a.npy", &npy("|u1", false, shape, &[]), true);
        e.size += size;
        e.packed.resize(packed, 0);
        e.compressed = packed as u64;
        e
    };
    for (what, entries, words) in [
        ("more than deflate can pack", vec![Entry { size: billion, ..honest() }], ["cannot hold", "1073741824"]),
        ("stored larger than it is", vec![Entry { method: 0, ..honest() }], ["cannot hold", "in"]),
        ("longer than the file", vec![Entry { compressed: billion, ..honest() }], ["leaves the file", "1073741824"]),
        ("a bomb within the cap", vec![bomb("(1073741824,)", billion, 2 << 20)], ["array `a`", "8589934592"]),
        ("a bomb of floats", vec![bomb("(40000000,)", 40_000_000, 60_000)], ["more than 100 to 1", "numpy.savez"]),
        (
            "a bomb over the cap",
            vec![bomb("(3000000000,)", 3_000_000_000, 4 << 20)],
            ["array `a`", "at most 2147483648"],
        ),
        (
            "less in it than it says",
            vec![Entry { size: twelve().len() as u64 + 8, ..honest() }],
            ["need 96", "announces 104"],
        ),
        ("another checksum", vec![Entry { crc: 1, ..honest() }], ["checksum", "00000001"]),
        ("encrypted", vec![Entry { flags: 1, ..honest() }], ["encrypted", "numpy.savez"]),
        ("bzip2", vec![Entry { method: 12, ..honest() }], ["method 12", "numpy.savez"]),
        ("another name inside", vec![Entry { own_name: "b.npy", ..honest() }], ["`a.npy`", "another name"]),
        ("no header", vec![Entry { offset: Some(7), ..honest() }], ["no header", "byte 7"]),
        (
            "a header far away",
            vec![Entry { offset: Some(u64::from(u32::MAX) - 1), ..honest() }],
            ["no header", "4294967294"],
        ),
    ] {
        for wide in [false, true] {
            let text = refusal(zip(&entries, wide, None));
            assert!(words.iter().all(|w| text.contains(w)), "{what}: {text}");
        }
    }
    // Inflates to less than announced: seen at the end, after no more memory than what came.
    let mut short = entry("a.npy", &twelve(), true);
    let longer = npy("<f8", false, "(13,)", &[0; 96]);
    short.packed = entry("a.npy", &longer, true).packed;
    (short.compressed, short.size) = (short.packed.len() as u64, longer.len() as u64 + 8);
    assert!(refusal(zip(&[short], false, None)).contains("96 bytes of data instead of 104"));
}

#[test]
fn entries_that_share_bytes_are_refused() {
    // The same bytes under one name a thousand times.
    let one = entry("a.npy", &twelve(), true);
    let many = vec![Entry { offset: Some(0), ..one.clone() }; 1000];
    assert!(refusal(zip(&many, false, None)).contains("overlap"));
    // An archive whose first entry holds the second, header and all (Fifield 2019, *A better zip bomb*).
    let inner = zip(&[entry("b.npy", &twelve(), false)], false, None);
    let outer =
        [entry("a.npy", &inner, false), Entry { offset: Some(35), packed: vec![], ..entry("b.npy", &twelve(), false) }];
    assert!(refusal(zip(&outer, false, None)).contains("overlap"));
    // An archive in an archive is data that nobody opens.
    let nested = zip(&[entry("a.npz", &inner, true)], false, None);
    assert!(open(nested).unwrap().names().is_empty());
    let twice = [one.clone(), one];
    assert!(refusal(zip(&twice, false, None)).contains("two entries are called `a.npy`"));
}

#[test]
fn directories_that_lie_are_refused() {
    let one = [entry("a.npy", &twelve(), false)];
    for (wide, count, word) in [
        (false, 2, "directory of 2 entries"),
        (false, 65534, "directory of 65534 entries"),
        (true, u64::MAX, "directory of 18446744073709551615 entries"),
        (true, 1 << 40, "directory of 1099511627776 entries"),
    ] {
        let text = refusal(zip(&one, wide, Some(count)));
        assert!(text.contains(word), "{text}");
    }
    assert!(refusal(b"PK".to_vec()).contains("no end of a zip directory"));
    // A locator that leads nowhere.
    let mut lost = zip(&one, true, None);
    let at = lost.len() - 22 - 20 + 8;
    lost[at..at + 8].fill(0xff);
    assert!(refusal(lost).contains("ZIP64"));
}

#[test]
fn values_that_are_not_finite_are_named_on_demand() {
    let values = [0.0, 1.0, 2.0, f64::NAN, 1e300, f64::INFINITY];
    let data: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
    let texts = npy("|S1", false, "(2000000,)", &vec![b'x'; 2_000_000]);
    let entries = [
        ("v", npy("<f8", false, "(3, 2)", &data)),
        ("large", npy("<f8", false, "(2, 2)", &[&data[..24], &data[32..40]].concat())),
        ("texts", texts),
    ];
    let npz = open(support::archive(&entries, true)).unwrap();
    assert!(npz.f64s("v").unwrap().data[3].is_nan());
    let text = npz.finite_f64s("v").unwrap_err().to_string();
    assert!(["body.npz", "`v`", "element [1, 1] of [3, 2]", "NaN"].iter().all(|w| text.contains(w)), "{text}");
    assert_eq!(npz.finite_f64s("large").unwrap().data[3], 1e300);
    let text = npz.finite_f32s("large").unwrap_err().to_string();
    assert!(text.contains("element [1, 1] of [2, 2]") && text.contains("inf"), "{text}");
    assert!(npz.strings("texts").unwrap_err().to_string().contains("2000000 texts"));
}
