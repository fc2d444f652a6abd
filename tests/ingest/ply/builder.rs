//! Writes PLY splat files in all variants.

use splatprobe::scene::sh;

/// How values follow the header.
#[derive(Clone, Copy, PartialEq)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

/// Where other elements stand.
#[derive(Clone, Copy, PartialEq)]
pub enum Others {
    Absent,
    Before,
    After,
}

#[derive(Clone)]
pub struct Builder {
    pub encoding: Encoding,
    pub line_end: &'static str,
    pub others: Others,
    /// Name and type of each column of the vertices.
    pub columns: Vec<(String, &'static str)>,
    pub rows: Vec<Vec<f64>>,
}

/// `rows` Gaussians of `degree`, all usable, with floats in the order of the original trainer.
pub fn splats(degree: u8, rows: usize) -> Builder {
    let rest = 3 * (sh::coefficient_count(degree) - 1);
    let start = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from);
    let end = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from);
    let names = start.into_iter().chain((0..rest).map(|i| format!("f_rest_{i}"))).chain(end);
    let columns: Vec<(String, &'static str)> = names.map(|name| (name, "float")).collect();
    let rows = (0..rows).map(|row| columns.iter().map(|(name, _)| value(row, name)).collect()).collect();
    Builder { encoding: Encoding::Little, line_end: "\n", others: Others::Absent, columns, rows }
}

/// What [`splats`] writes: small integers, which every type holds; unsigned ones for `opacity` and `rot_0`.
pub fn value(row: usize, name: &str) -> f64 {
    let hash = name.bytes().fold(row * 7 + 3, |hash, byte| (hash * 31 + usize::from(byte)) % 1009);
    match name {
        "opacity" => 2.0 + (row % 100) as f64,
        "rot_0" => 1.0,
        name if name.starts_with("scale_") => -((hash % 5) as f64) - 1.0,
        _ => (hash % 13) as f64 - 6.0,
    }
}

impl Builder {
    fn column(&self, name: &str) -> usize {
        self.columns.iter().position(|(column, _)| column == name).expect("a column of the builder")
    }

    pub fn get(&self, row: usize, name: &str) -> f64 {
        self.rows[row][self.column(name)]
    }

    pub fn set(mut self, row: usize, name: &str, value: f64) -> Self {
        let column = self.column(name);
        self.rows[row][column] = value;
        self
    }

    pub fn without(mut self, name: &str) -> Self {
        let column = self.column(name);
        self.columns.remove(column);
        for row in &mut self.rows {
            row.remove(column);
        }
        self
    }

    pub fn reversed(mut self) -> Self {
        self.columns.reverse();
        self.rows.iter_mut().for_each(|row| row.reverse());
        self
    }

    /// With the type that `kind` gives for each column's number and name.
    pub fn typed(mut self, kind: impl Fn(usize, &str) -> &'static str) -> Self {
        for (i, (name, column)) in self.columns.iter_mut().enumerate() {
            *column = kind(i, name);
        }
        self
    }

    pub fn encoded(mut self, encoding: Encoding) -> Self {
        self.encoding = encoding;
        self
    }

    pub fn header(&self) -> String {
        let encoding = match self.encoding {
            Encoding::Ascii => "ascii",
            Encoding::Little => "binary_little_endian",
            Encoding::Big => "binary_big_endian",
        };
        let others = "element camera 2\nproperty float focal\nproperty short id\nelement empty 9\n\
                      element face 3\nproperty list uchar int vertex_index\nproperty double quality\n";
        let mut header = format!("ply\nformat {encoding} 1.0\ncomment written by a test\nobj_info none\n");
        if self.others == Others::Before {
            header += others;
        }
        header += &format!("element vertex {}\n", self.rows.len());
        for (name, kind) in &self.columns {
            header += &format!("property {kind} {name}\n");
        }
        if self.others == Others::After {
            header += others;
        }
        (header + "end_header\n").replace('\n', self.line_end)
    }

    pub fn bytes(&self) -> Vec<u8> {
        let mut out = self.header().into_bytes();
        if self.others == Others::Before {
            self.push_others(&mut out);
        }
        for row in &self.rows {
            for (value, (_, kind)) in row.iter().zip(&self.columns) {
                self.push(&mut out, kind, *value);
            }
            if self.encoding == Encoding::Ascii {
                out.extend(self.line_end.bytes());
            }
        }
        if self.others == Others::After {
            self.push_others(&mut out);
        }
        out
    }

    fn push_others(&self, out: &mut Vec<u8>) {
        for camera in [1.0, 2.0] {
            self.push(out, "float", camera);
            self.push(out, "short", camera);
        }
        for corners in [3_u8, 0, 4] {
            self.push(out, "uchar", corners.into());
            (0..corners).for_each(|corner| self.push(out, "int", corner.into()));
            self.push(out, "double", 0.5);
        }
    }

    fn push(&self, out: &mut Vec<u8>, kind: &str, value: f64) {
        if self.encoding == Encoding::Ascii {
            out.extend(format!("{value} ").bytes());
            return;
        }
        let mut bytes = match kind {
            "char" | "int8" => (value as i8).to_le_bytes().to_vec(),
            "uchar" | "uint8" => (value as u8).to_le_bytes().to_vec(),
            "short" | "int16" => (value as i16).to_le_bytes().to_vec(),
            "ushort" | "uint16" => (value as u16).to_le_bytes().to_vec(),
            "int" | "int32" => (value as i32).to_le_bytes().to_vec(),
            "uint" | "uint32" => (value as u32).to_le_bytes().to_vec(),
            "float" | "float32" => (value as f32).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        };
        if self.encoding == Encoding::Big {
            bytes.reverse();
        }
        out.extend(bytes);
    }
}
