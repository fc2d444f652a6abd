//! Whether a binary USD file (crate) can be handed to the `openusd` crate.
//!
//! That crate allocates whatever a file's counts say, walks whatever its jumps say, and recurses as deep as its
//! dictionaries are nested: a hostile file would end the process or never return. Here every count is held against the
//! bytes that must stand for it, the tree of paths is walked in linear time, and nesting is bounded. What is merely wrong
//! (an index out of range) is left to the reader, whose panics are caught.
//!
//! Layout: OpenUSD's crateFile.cpp and integerCoding.cpp, versions 0.4.0 and later.

/// What a crate begins with.
pub const MAGIC: &[u8] = b"PXR-USDC";

/// LZ4's highest ratio of decompressed to compressed bytes.
const LZ4_RATIO: usize = 255;

/// Deepest nesting of dictionaries and time samples.
const MAX_DEPTH: u32 = 32;

/// What is wrong, and where: a byte offset or a section.
type Fault = (String, String);

/// Checks the crate in `bytes`.
pub fn check(bytes: &[u8]) -> Result<(), Fault> {
    let file = Crate::new(bytes)?;
    let tokens = file.tokens()?;
    file.counted("STRINGS", 4)?;
    file.paths(&tokens)?;
    for name in ["FIELDSETS", "SPECS"] {
        let Some(mut cursor) = file.section(name)? else { continue };
        let count = file.justified(cursor.count()?, &cursor)?;
        for _ in 0..if name == "SPECS" { 3 } else { 1 } {
            cursor.skip_ints(count)?;
        }
    }
    for rep in file.value_reps()? {
        let mut budget = Budget { values: bytes.len(), bytes: file.most_decoded() };
        file.value(rep, &mut budget, 0)?;
    }
    Ok(())
}

fn fault<T>(place: impl Into<String>, what: impl Into<String>) -> Result<T, Fault> {
    Err((place.into(), what.into()))
}

struct Crate<'a> {
    bytes: &'a [u8],
    /// Major, minor, patch.
    version: [u8; 3],
    /// Names and places, in the file's order.
    sections: Vec<(&'a [u8], usize)>,
}

/// What decoding one field's value may still take.
struct Budget {
    values: usize,
    bytes: usize,
}

impl Budget {
    fn take(&mut self, at: usize, bytes: usize) -> Result<(), Fault> {
        match (self.values.checked_sub(1), self.bytes.checked_sub(bytes)) {
            (Some(values), Some(bytes)) => {
                *self = Self { values, bytes };
                Ok(())
            }
            _ => fault(format!("byte {at}"), "a value decodes to far more than the file's size justifies"),
        }
    }
}

impl<'a> Crate<'a> {
    fn new(bytes: &'a [u8]) -> Result<Self, Fault> {
        let mut cursor = Cursor { bytes, at: MAGIC.len() };
        let version = [cursor.byte()?, cursor.byte()?, cursor.byte()?];
        if version[0] != 0 || !(4..=12).contains(&version[1]) {
            let [major, minor, patch] = version;
            return fault("byte 8", format!("crate version {major}.{minor}.{patch}; 0.4.0 to 0.12 are read"));
        }
        cursor.at = 16;
        cursor.seek(cursor.clone().word()?)?;
        let count = cursor.count()?;
        if count > 64 {
            return fault(format!("byte {}", cursor.at - 8), format!("{count} sections"));
        }
        let mut sections = Vec::with_capacity(count);
        for _ in 0..count {
            let name = cursor.take(16)?;
            let name = &name[..name.iter().position(|&byte| byte == 0).unwrap_or(16)];
            let start = cursor.word()?;
            cursor.word()?;
            sections.push((name, usize::try_from(start).unwrap_or(usize::MAX)));
        }
        Ok(Self { bytes, version, sections })
    }

    /// The start of a section, if there is one.
    fn section(&self, name: &str) -> Result<Option<Cursor<'a>>, Fault> {
        let Some((_, start)) = self.sections.iter().find(|(found, _)| *found == name.as_bytes()) else {
            return Ok(None);
        };
        let mut cursor = Cursor { bytes: self.bytes, at: 0 };
        cursor.seek(*start as u64)?;
        Ok(Some(cursor))
    }

    /// A count of things that take a byte of the file each, before compression, or a small multiple of it.
    fn justified(&self, count: usize, cursor: &Cursor) -> Result<usize, Fault> {
        if count > self.bytes.len() {
            return fault(
                format!("byte {}", cursor.at),
                format!("{count} entries in a file of {} bytes", self.bytes.len()),
            );
        }
        Ok(count)
    }

    /// Most bytes that tokens, paths or one field's value may decode to.
    fn most_decoded(&self) -> usize {
        self.bytes.len().saturating_mul(16).max(1 << 20)
    }

    /// A section of a count and as many entries of `size` bytes.
    fn counted(&self, name: &str, size: usize) -> Result<(), Fault> {
        let Some(mut cursor) = self.section(name)? else { return Ok(()) };
        let count = cursor.count()?;
        cursor.skip(count, size)
    }

    /// Length of each token, and whether it can be an element of a path.
    fn tokens(&self) -> Result<Vec<(usize, bool)>, Fault> {
        let Some(mut cursor) = self.section("TOKENS")? else { return Ok(Vec::new()) };
        let count = cursor.count()?;
        let size = cursor.count()?;
        if size > self.most_decoded() {
            return fault("TOKENS", format!("{size} bytes of tokens in a file of {} bytes", self.bytes.len()));
        }
        let text = cursor.decompress(size)?;
        let tokens: Vec<_> = text.split(|&byte| byte == 0).map(|token| (token.len(), is_path_element(token))).collect();
        if count > tokens.len() {
            return fault("TOKENS", format!("it promises {count} tokens and has {}", tokens.len()));
        }
        Ok(tokens)
    }

    /// Walks the tree of paths: every entry once, and no more text than the file's size justifies.
    fn paths(&self, tokens: &[(usize, bool)]) -> Result<(), Fault> {
        let Some(mut cursor) = self.section("PATHS")? else { return Ok(()) };
        let path_count = cursor.count()?;
        self.justified(path_count, &cursor)?;
        let count = cursor.count()?;
        self.justified(count, &cursor)?;
        let indices = cursor.ints(count)?;
        let elements = cursor.ints(count)?;
        let jumps = cursor.ints(count)?;
        let mut seen = vec![false; count];
        let mut budget = self.most_decoded();
        let mut pending = if count > 0 { vec![(0usize, 0usize)] } else { Vec::new() };
        while let Some((mut index, mut parent_length)) = pending.pop() {
            loop {
                let here = || format!("PATHS entry {index}");
                match seen.get_mut(index) {
                    Some(seen) if !*seen => *seen = true,
                    _ => return fault(here(), "the tree of paths has a loop or leaves the section"),
                }
                let token = elements[index].unsigned_abs() as usize;
                let length = match (index, tokens.get(token)) {
                    (0, _) => 1,
                    (_, Some((length, true))) => parent_length + 1 + length,
                    _ => return fault(here(), format!("token {token} is out of range or no name")),
                };
                budget = match budget.checked_sub(length) {
                    Some(budget) if (indices[index] as u32 as usize) < path_count => budget,
                    _ => return fault(here(), "its path is out of range, or too long for the file's size"),
                };
                let jump = jumps[index];
                let (has_child, has_sibling) = (jump > 0 || jump == -1, jump >= 0);
                if has_child {
                    if has_sibling {
                        pending.push((index + jump as usize, parent_length));
                    }
                    parent_length = length;
                } else if !has_sibling {
                    break;
                }
                index += 1;
            }
        }
        Ok(())
    }

    /// What stands for each field's value.
    fn value_reps(&self) -> Result<Vec<u64>, Fault> {
        let Some(mut cursor) = self.section("FIELDS")? else { return Ok(Vec::new()) };
        let count = cursor.count()?;
        self.justified(count, &cursor)?;
        cursor.skip_ints(count)?;
        let reps = cursor.decompress(8 * count)?;
        Ok(reps.as_chunks::<8>().0.iter().map(|rep| u64::from_le_bytes(*rep)).collect())
    }

    /// Checks the counts of the value that `rep` stands for, and of what is nested in it.
    fn value(&self, rep: u64, budget: &mut Budget, depth: u32) -> Result<(), Fault> {
        let (array, inlined, compressed) = (rep >> 63 & 1 == 1, rep >> 62 & 1 == 1, rep >> 61 & 1 == 1);
        let (kind, payload) = ((rep >> 48 & 0xFF) as u8, rep & 0xFFFF_FFFF_FFFF);
        let mut cursor = Cursor { bytes: self.bytes, at: usize::try_from(payload).unwrap_or(usize::MAX) };
        budget.take(cursor.at, 0)?;
        if depth > MAX_DEPTH {
            return fault(format!("byte {}", cursor.at), "values are nested too deeply");
        }
        if array || kind == DOUBLE_VECTOR {
            return if payload == 0 { Ok(()) } else { self.array(kind, compressed, cursor, budget) };
        }
        if inlined {
            return Ok(());
        }
        match kind {
            TOKEN_LIST_OP | STRING_LIST_OP | PATH_LIST_OP | INT_LIST_OP | UINT_LIST_OP | UNREGISTERED_LIST_OP => {
                self.list_op(cursor, budget, |cursor, count, _| cursor.skip(count, 4))
            }
            INT64_LIST_OP | UINT64_LIST_OP => self.list_op(cursor, budget, |cursor, count, _| cursor.skip(count, 8)),
            REFERENCE_LIST_OP => self.list_op(cursor, budget, |cursor, count, budget| {
                cursor.clone().skip(count, 32)?;
                (0..count).try_for_each(|_| {
                    cursor.skip(1, 24)?;
                    self.dictionary(cursor, budget, depth)
                })
            }),
            PAYLOAD_LIST_OP => {
                let size = if self.version[1] < 8 { 8 } else { 24 };
                self.list_op(cursor, budget, |cursor, count, _| cursor.skip(count, size))
            }
            PATH_VECTOR | TOKEN_VECTOR | STRING_VECTOR => self.counted_items(&mut cursor, 4, budget),
            VARIANT_SELECTIONS | RELOCATES => self.counted_items(&mut cursor, 8, budget),
            LAYER_OFFSETS => self.counted_items(&mut cursor, 16, budget),
            DICTIONARY => self.dictionary(&mut cursor, budget, depth),
            TIME_SAMPLES => self.time_samples(&mut cursor, budget, depth),
            _ => Ok(()),
        }
    }

    fn counted_items(&self, cursor: &mut Cursor, size: usize, budget: &mut Budget) -> Result<(), Fault> {
        let count = cursor.count()?;
        budget.take(cursor.at, count.saturating_mul(size))?;
        cursor.skip(count, size)
    }

    /// The items of a list operation: a byte of flags, then a counted list for each flag but the first.
    fn list_op(
        &self,
        mut cursor: Cursor,
        budget: &mut Budget,
        mut items: impl FnMut(&mut Cursor, usize, &mut Budget) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let flags = cursor.byte()?;
        for _ in 0..(flags >> 1).count_ones() {
            let count = cursor.count()?;
            self.justified(count, &cursor)?;
            items(&mut cursor, count, budget)?;
        }
        Ok(())
    }

    /// Key, then an offset from where it stands to the value's representation, as often as the count says.
    fn dictionary(&self, cursor: &mut Cursor, budget: &mut Budget, depth: u32) -> Result<(), Fault> {
        let count = cursor.count()?;
        self.justified(count, cursor)?;
        for _ in 0..count {
            cursor.skip(1, 4)?;
            cursor.follow()?;
            let rep = cursor.word()?;
            self.value(rep, budget, depth + 1)?;
        }
        Ok(())
    }

    fn time_samples(&self, cursor: &mut Cursor, budget: &mut Budget, depth: u32) -> Result<(), Fault> {
        cursor.follow()?;
        let times = cursor.word()?;
        self.value(times, budget, depth + 1)?;
        cursor.follow()?;
        let count = cursor.count()?;
        cursor.clone().skip(count, 8)?;
        (0..count).try_for_each(|_| self.value(cursor.word()?, budget, depth + 1))
    }

    /// A counted array: plain elements, compressed integers, or floats as integers or through a table.
    fn array(&self, kind: u8, compressed: bool, mut cursor: Cursor, budget: &mut Budget) -> Result<(), Fault> {
        let at = cursor.at;
        if matches!(kind, STRING | ASSET_PATH | PATH_EXPRESSION) {
            return self.counted_items(&mut cursor, 4, budget);
        }
        if self.version[1] < 5 {
            cursor.skip(1, 4)?;
        }
        let count = if self.version[1] < 7 { cursor.half_word()? as usize } else { cursor.count()? };
        let Some(size) = element_size(kind) else { return Ok(()) };
        budget.take(at, count.saturating_mul(size))?;
        let first_compressed_version = match kind {
            3..=6 => 5,
            7..=9 | DOUBLE_VECTOR | TIME_CODE => 6,
            _ => u8::MAX,
        };
        if !compressed || count < 4 || self.version[1] < first_compressed_version {
            return cursor.skip(count, size);
        }
        if first_compressed_version == 6 && cursor.byte()? == b't' {
            let table = cursor.half_word()? as usize;
            cursor.skip(table, size)?;
        }
        cursor.skip_ints(count)
    }
}

/// Whether `token` is a name, or a variant as `{set=selection}`: the reader looks for braces where variants end, and recurses
/// without end over others.
fn is_path_element(token: &[u8]) -> bool {
    let inside = match token {
        [b'{', inside @ .., b'}'] => inside,
        name => name,
    };
    !token.is_empty() && !inside.iter().any(|byte| matches!(byte, b'{' | b'}' | b'/'))
}

const STRING: u8 = 10;
const ASSET_PATH: u8 = 12;
const DICTIONARY: u8 = 31;
const TOKEN_LIST_OP: u8 = 32;
const STRING_LIST_OP: u8 = 33;
const PATH_LIST_OP: u8 = 34;
const REFERENCE_LIST_OP: u8 = 35;
const INT_LIST_OP: u8 = 36;
const INT64_LIST_OP: u8 = 37;
const UINT_LIST_OP: u8 = 38;
const UINT64_LIST_OP: u8 = 39;
const PATH_VECTOR: u8 = 40;
const TOKEN_VECTOR: u8 = 41;
const VARIANT_SELECTIONS: u8 = 45;
const TIME_SAMPLES: u8 = 46;
const DOUBLE_VECTOR: u8 = 48;
const LAYER_OFFSETS: u8 = 49;
const STRING_VECTOR: u8 = 50;
const UNREGISTERED_LIST_OP: u8 = 54;
const PAYLOAD_LIST_OP: u8 = 55;
const TIME_CODE: u8 = 56;
const PATH_EXPRESSION: u8 = 57;
const RELOCATES: u8 = 58;

/// Bytes of an array's element, by the number of its type; `None` for types that have no arrays.
fn element_size(kind: u8) -> Option<usize> {
    Some(match kind {
        1 | 2 => 1,
        7 => 2,
        3 | 4 | 8 | 11 | 21 => 4,
        25 => 6,
        5 | 6 | 9 | 18 | 20 | 22 | 29 | DOUBLE_VECTOR | TIME_CODE => 8,
        24 | 26 => 12,
        17 | 19 | 28 | 30 => 16,
        23 => 24,
        13 | 16 | 27 => 32,
        14 => 72,
        15 => 128,
        _ => return None,
    })
}

/// A position in the file. Every step checks the end.
#[derive(Clone)]
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], Fault> {
        let end = self.at.checked_add(length);
        let Some(taken) = end.and_then(|end| self.bytes.get(self.at..end)) else {
            return fault(format!("byte {}", self.at), format!("{length} bytes reach past the end; it is cut off"));
        };
        self.at += length;
        Ok(taken)
    }

    fn skip(&mut self, count: usize, size: usize) -> Result<(), Fault> {
        self.take(count.saturating_mul(size)).map(drop)
    }

    fn seek(&mut self, to: u64) -> Result<(), Fault> {
        match usize::try_from(to).ok().filter(|&to| to <= self.bytes.len()) {
            Some(to) => {
                self.at = to;
                Ok(())
            }
            None => fault(format!("byte {}", self.at), format!("it points to byte {to}, past the end")),
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn byte(&mut self) -> Result<u8, Fault> {
        self.array().map(|[byte]| byte)
    }

    fn half_word(&mut self) -> Result<u32, Fault> {
        self.array().map(u32::from_le_bytes)
    }

    fn word(&mut self) -> Result<u64, Fault> {
        self.array().map(u64::from_le_bytes)
    }

    fn count(&mut self) -> Result<usize, Fault> {
        self.word().map(|count| usize::try_from(count).unwrap_or(usize::MAX))
    }

    /// Goes where a signed offset points, counted from where it stands.
    fn follow(&mut self) -> Result<(), Fault> {
        let from = self.at as u64;
        let offset = self.word()? as i64;
        self.seek(from.checked_add_signed(offset).unwrap_or(u64::MAX))
    }

    /// A compressed block that holds at most `most` bytes.
    fn decompress(&mut self, most: usize) -> Result<Vec<u8>, Fault> {
        let size = self.count()?;
        let at = self.at;
        let block = self.take(size)?;
        if most / LZ4_RATIO > size {
            return fault(format!("byte {at}"), format!("{size} compressed bytes cannot hold {most}"));
        }
        match block.split_first() {
            Some((0, block)) => {
                let mut output = vec![0; most];
                let length = lz4_flex::block::decompress_into(block, &mut output)
                    .map_err(|error| (format!("byte {at}"), format!("it does not decompress: {error}")))?;
                output.truncate(length);
                Ok(output)
            }
            Some(_) => fault(format!("byte {at}"), "blocks in several chunks are not supported"),
            None => fault(format!("byte {at}"), "an empty compressed block"),
        }
    }

    /// Passes over a block of `count` compressed integers that could hold them.
    fn skip_ints(&mut self, count: usize) -> Result<(), Fault> {
        let size = self.count()?;
        let at = self.at;
        self.skip(size, 1)?;
        // Two bits for each integer at least.
        if count > 0 && (4 + count.div_ceil(4)) / LZ4_RATIO > size {
            return fault(format!("byte {at}"), format!("{size} compressed bytes cannot hold {count} integers"));
        }
        Ok(())
    }

    /// `count` compressed 32-bit integers: a common difference, two bits for each integer's size, and the differences.
    fn ints(&mut self, count: usize) -> Result<Vec<i32>, Fault> {
        if count == 0 {
            self.skip_ints(0)?;
            return Ok(Vec::new());
        }
        let at = self.at;
        let codes = count.div_ceil(4);
        self.clone().skip_ints(count)?;
        let smallest = 4 + codes;
        let encoded = self.clone().decompress_at_most(smallest + 4 * count)?;
        self.skip_ints(count)?;
        let mut differences = Cursor { bytes: &encoded, at: smallest };
        let short = || (format!("byte {at}"), format!("it does not hold {count} integers"));
        let common = i32::from_le_bytes(encoded.get(..4).and_then(|it| it.try_into().ok()).ok_or_else(short)?);
        let mut previous = 0i32;
        let mut integers = Vec::with_capacity(count);
        for i in 0..count {
            let code = encoded.get(4 + i / 4).ok_or_else(short)? >> (2 * (i % 4)) & 3;
            let difference = match code {
                0 => common,
                1 => i32::from(differences.array().map(i8::from_le_bytes).map_err(|_| short())?),
                2 => i32::from(differences.array().map(i16::from_le_bytes).map_err(|_| short())?),
                _ => differences.array().map(i32::from_le_bytes).map_err(|_| short())?,
            };
            previous = previous.wrapping_add(difference);
            integers.push(previous);
        }
        Ok(integers)
    }

    /// Like [`Self::decompress`] for a block that may hold far less than `most` bytes.
    fn decompress_at_most(&mut self, most: usize) -> Result<Vec<u8>, Fault> {
        let size = self.clone().count()?;
        self.decompress(most.min(size.saturating_mul(LZ4_RATIO)))
    }
}
