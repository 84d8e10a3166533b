//! The zip layer: a directory that is checked as a whole when the archive is opened, and entries that are inflated
//! on demand. PKWARE's APPNOTE 6.3 with ZIP64, methods 0 (stored) and 8 (deflated): what `numpy.savez` writes.
//!
//! Every size is held against the bytes that are there before it is believed: entries lie one behind the other, in
//! front of the directory, and none is larger than deflate can make out of its bytes.

use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use std::io::Read;

/// Most bytes that deflate makes out of one: 258 for each 2 bits, less what a block takes.
const MOST_INFLATED: u64 = 1032;

/// Why an archive is refused: the problem and what to do.
pub(super) struct Refused {
    pub(super) problem: String,
    pub(super) remedy: &'static str,
}

const GET_AGAIN: &str = "the file is damaged, cut off or no .npz: get it again";
const DECEIVES: &str = "the file is damaged or made to deceive: get it again";
const SAVE_AGAIN: &str = "save it with numpy.savez or numpy.savez_compressed";

fn refused<T>(problem: impl Into<String>, remedy: &'static str) -> Result<T, Refused> {
    Err(Refused { problem: problem.into(), remedy })
}

/// An entry of the directory, checked against the file.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) name: String,
    /// Size [bytes] after inflating, as the directory says.
    pub(super) size: u64,
    pub(super) compressed: u64,
    /// Where its bytes start in the file.
    start: usize,
    method: u16,
    encrypted: bool,
    crc: u32,
}

/// Numbers of a little-endian record, each at its place.
#[derive(Clone, Copy)]
struct Record<'a>(&'a [u8]);

impl<'a> Record<'a> {
    /// `length` bytes at `at` that start with `signature`.
    fn at(bytes: &'a [u8], at: u64, length: usize, signature: &[u8]) -> Option<Self> {
        let rest = bytes.get(usize::try_from(at).ok()?..)?;
        (rest.len() >= length && rest.starts_with(signature)).then_some(Self(rest))
    }
    fn u16(self, at: usize) -> u16 {
        self.0.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u16::from_le_bytes(*b))
    }
    fn u32(self, at: usize) -> u32 {
        self.0.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b))
    }
    fn u64(self, at: usize) -> u64 {
        self.0.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u64::from_le_bytes(*b))
    }
    fn slice(self, at: usize, length: usize) -> Option<&'a [u8]> {
        self.0.get(at..)?.get(..length)
    }
}

/// Length [bytes] of the fixed part of a directory entry.
const DIRECTORY_ENTRY: usize = 46;
/// Length [bytes] of the fixed part of the header in front of an entry.
const LOCAL_HEADER: usize = 30;
/// Length [bytes] of the directory's end without its comment.
const DIRECTORY_END: usize = 22;

/// All entries, sorted by name.
pub(super) fn read_directory(bytes: &[u8]) -> Result<Vec<Entry>, Refused> {
    let (place, size, count) = find_directory(bytes)?;
    let end = place.checked_add(size).filter(|&e| e <= bytes.len() as u64);
    let (Some(end), true) = (end, count <= size / DIRECTORY_ENTRY as u64) else {
        return refused(format!("a directory of {count} entries and {size} bytes at byte {place}"), GET_AGAIN);
    };
    let mut entries = Vec::with_capacity(count as usize);
    let mut at = place;
    for number in 0..count {
        let Some((entry, length)) = read_entry(bytes, at, place)? else {
            return refused(format!("entry {number} of {count} in the directory is damaged"), GET_AGAIN);
        };
        entries.push(entry);
        at += length;
        if at > end {
            return refused(format!("entry {number} of {count} leaves the directory"), GET_AGAIN);
        }
    }
    entries.sort_by_key(|e| e.start);
    for pair in entries.windows(2) {
        // Their bytes are counted once each, or a small file could name the same bytes a thousand times.
        if pair[0].start as u64 + pair[0].compressed > pair[1].start as u64 {
            let (a, b) = (&pair[0].name, &pair[1].name);
            return refused(format!("entries `{a:.80}` and `{b:.80}` overlap"), DECEIVES);
        }
    }
    entries.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(pair) = entries.windows(2).find(|p| p[0].name == p[1].name) {
        return refused(format!("two entries are called `{:.80}`", pair[0].name), DECEIVES);
    }
    Ok(entries)
}

/// Place, size [bytes] and number of entries of the directory.
fn find_directory(bytes: &[u8]) -> Result<(u64, u64, u64), Refused> {
    // The end stands last, in front of a comment of up to 65535 bytes, whose length must fit.
    let earliest = bytes.len().saturating_sub(DIRECTORY_END + usize::from(u16::MAX));
    let mut places = (earliest..(bytes.len() + 1).saturating_sub(DIRECTORY_END)).rev();
    let found = places.find_map(|at| {
        let end = Record::at(bytes, at as u64, DIRECTORY_END, b"PK\x05\x06")?;
        (at + DIRECTORY_END + usize::from(end.u16(20)) == bytes.len()).then_some((at, end))
    });
    let Some((at, end)) = found else {
        return refused("no end of a zip directory", GET_AGAIN);
    };
    let plain = (u64::from(end.u32(16)), u64::from(end.u32(12)), u64::from(end.u16(10)));
    let disks = [end.u16(4), end.u16(6)];
    if plain.0 != u64::from(u32::MAX) && plain.1 != u64::from(u32::MAX) && plain.2 != u64::from(u16::MAX) {
        return if disks == [0, 0] { Ok(plain) } else { refused("an archive in several parts", SAVE_AGAIN) };
    }
    // A full field sends to the ZIP64 record, through a locator right in front of the end.
    let locator = at.checked_sub(20).and_then(|at| Record::at(bytes, at as u64, 20, b"PK\x06\x07"));
    match locator.and_then(|l| Record::at(bytes, l.u64(8), 56, b"PK\x06\x06")) {
        Some(end64) => Ok((end64.u64(48), end64.u64(40), end64.u64(32))),
        None => refused("no ZIP64 directory where the zip directory refers to one", GET_AGAIN),
    }
}

/// An entry and its length [bytes] in the directory, which starts at `directory`; `None` where no entry stands.
fn read_entry(bytes: &[u8], at: u64, directory: u64) -> Result<Option<(Entry, u64)>, Refused> {
    let Some(record) = Record::at(bytes, at, DIRECTORY_ENTRY, b"PK\x01\x02") else { return Ok(None) };
    let lengths = [28, 30, 32].map(|field| usize::from(record.u16(field)));
    let total = DIRECTORY_ENTRY + lengths.iter().sum::<usize>();
    let (Some(raw_name), Some(mut extra)) =
        (record.slice(DIRECTORY_ENTRY, lengths[0]), record.slice(DIRECTORY_ENTRY + lengths[0], lengths[1]))
    else {
        return Ok(None);
    };
    let name = String::from_utf8_lossy(raw_name).into_owned();
    let mut size = u64::from(record.u32(24));
    let mut compressed = u64::from(record.u32(20));
    let mut header = u64::from(record.u32(42));
    while let Some((head, rest)) = extra.split_at_checked(4) {
        let length = usize::from(Record(head).u16(2)).min(rest.len());
        if Record(head).u16(0) == 1 {
            // ZIP64: the full fields, in this order.
            let mut wide = rest[..length].as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b));
            for field in [&mut size, &mut compressed, &mut header] {
                if *field == u64::from(u32::MAX) {
                    *field = wide.next().unwrap_or(*field);
                }
            }
        }
        extra = &rest[length..];
    }
    let local = Record::at(bytes, header, LOCAL_HEADER, b"PK\x03\x04");
    let Some((start, local)) =
        local.map(|l| (header + (LOCAL_HEADER + usize::from(l.u16(26)) + usize::from(l.u16(28))) as u64, l))
    else {
        return refused(format!("entry `{name:.80}` has no header at byte {header}"), GET_AGAIN);
    };
    if local.slice(LOCAL_HEADER, usize::from(local.u16(26))) != Some(raw_name) {
        return refused(format!("entry `{name:.80}` has another name in its own header"), DECEIVES);
    }
    let ends_before_directory = start.checked_add(compressed).is_some_and(|end| end <= directory);
    let (Ok(start), true) = (usize::try_from(start), ends_before_directory) else {
        return refused(format!("entry `{name:.80}` of {compressed} bytes at byte {start} leaves the file"), GET_AGAIN);
    };
    let method = record.u16(10);
    let possible = match method {
        0 => compressed == size,
        8 => size <= compressed.saturating_mul(MOST_INFLATED),
        // Not read, whatever it holds.
        _ => true,
    };
    if !possible {
        let problem = format!("entry `{name:.80}` cannot hold {size} bytes in {compressed}");
        return refused(problem, DECEIVES);
    }
    let encrypted = record.u16(8) & 1 == 1;
    Ok(Some((Entry { name, size, compressed, start, method, encrypted, crc: record.u32(16) }, total as u64)))
}

impl Entry {
    /// Its bytes, inflated as they are read.
    pub(super) fn open<'a>(&self, bytes: &'a [u8]) -> Result<Content<'a>, Refused> {
        if self.encrypted {
            return refused("is encrypted", SAVE_AGAIN);
        }
        let packed = bytes.get(self.start..).and_then(|b| b.get(..self.compressed as usize)).unwrap_or_default();
        let source = match self.method {
            0 => Source::Stored(packed),
            8 => Source::Deflated(DeflateDecoder::new(packed)),
            other => return refused(format!("is packed by zip's method {other}"), SAVE_AGAIN),
        };
        Ok(Content { source, crc: Crc::new(), wanted: self.crc })
    }
}

enum Source<'a> {
    Stored(&'a [u8]),
    Deflated(DeflateDecoder<&'a [u8]>),
}

/// The bytes of an entry. The checksum is held against them at [`Content::finish`].
pub(super) struct Content<'a> {
    source: Source<'a>,
    crc: Crc,
    wanted: u32,
}

impl Read for Content<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = match &mut self.source {
            Source::Stored(rest) => rest.read(buffer)?,
            Source::Deflated(decoder) => decoder.read(buffer)?,
        };
        self.crc.update(&buffer[..count]);
        Ok(count)
    }
}

impl Content<'_> {
    /// After the last byte: whether the checksum is right.
    pub(super) fn finish(&self) -> Result<(), String> {
        let got = self.crc.sum();
        if got == self.wanted { Ok(()) } else { Err(format!("checksum {got:08x} instead of {:08x}", self.wanted)) }
    }
}
