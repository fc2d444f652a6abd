//! Attribute values as numbers, whatever precision the file has them in.

use half::f16;
use openusd::sdf::Value;

/// The numbers of a scalar, vector, quaternion (w x y z) or matrix of any precision.
pub fn numbers(value: &Value) -> Option<Vec<f64>> {
    Some(match value {
        Value::Bool(x) => vec![f64::from(u8::from(*x))],
        Value::Int(x) => vec![f64::from(*x)],
        Value::Half(x) => vec![x.to_f64()],
        Value::Float(x) => vec![f64::from(*x)],
        Value::Double(x) => vec![*x],
        Value::Vec2h(v) => vec![v.x.to_f64(), v.y.to_f64()],
        Value::Vec2f(v) => vec![f64::from(v.x), f64::from(v.y)],
        Value::Vec2d(v) => vec![v.x, v.y],
        Value::Vec3h(v) => vec![v.x.to_f64(), v.y.to_f64(), v.z.to_f64()],
        Value::Vec3f(v) => vec![f64::from(v.x), f64::from(v.y), f64::from(v.z)],
        Value::Vec3d(v) => vec![v.x, v.y, v.z],
        Value::Vec4h(v) => vec![v.x.to_f64(), v.y.to_f64(), v.z.to_f64(), v.w.to_f64()],
        Value::Vec4f(v) => vec![f64::from(v.x), f64::from(v.y), f64::from(v.z), f64::from(v.w)],
        Value::Vec4d(v) => vec![v.x, v.y, v.z, v.w],
        Value::Quath(q) => vec![q.w.to_f64(), q.x.to_f64(), q.y.to_f64(), q.z.to_f64()],
        Value::Quatf(q) => vec![f64::from(q.w), f64::from(q.x), f64::from(q.y), f64::from(q.z)],
        Value::Quatd(q) => vec![q.w, q.x, q.y, q.z],
        Value::Matrix4d(matrix) => matrix.0.to_vec(),
        _ => return None,
    })
}

/// The elements of an array of vectors of `N` numbers, or of plain numbers for `N` = 1. Quaternions are w x y z.
pub fn vectors<const N: usize>(value: Value) -> Option<Vec<[f32; N]>> {
    let floats = |arity: usize, floats: Vec<f32>| (arity, floats);
    let halves = |arity: usize, halves: Vec<f16>| (arity, halves.into_iter().map(f16::to_f32).collect());
    let doubles = |arity: usize, doubles: Vec<f64>| (arity, doubles.into_iter().map(|x| x as f32).collect());
    let (arity, flat) = match value {
        Value::FloatVec(values) => floats(1, values),
        Value::HalfVec(values) => halves(1, bytemuck::cast_vec(values)),
        Value::DoubleVec(values) => doubles(1, values),
        Value::Vec2fVec(values) => floats(2, bytemuck::cast_vec(values)),
        Value::Vec2hVec(values) => halves(2, bytemuck::cast_vec(values)),
        Value::Vec2dVec(values) => doubles(2, bytemuck::cast_vec(values)),
        Value::Vec3fVec(values) => floats(3, bytemuck::cast_vec(values)),
        Value::Vec3hVec(values) => halves(3, bytemuck::cast_vec(values)),
        Value::Vec3dVec(values) => doubles(3, bytemuck::cast_vec(values)),
        Value::Vec4fVec(values) => floats(4, bytemuck::cast_vec(values)),
        Value::Vec4hVec(values) => halves(4, bytemuck::cast_vec(values)),
        Value::Vec4dVec(values) => doubles(4, bytemuck::cast_vec(values)),
        Value::QuatfVec(values) => floats(4, bytemuck::cast_vec(values)),
        Value::QuathVec(values) => halves(4, bytemuck::cast_vec(values)),
        _ => return None,
    };
    (arity == N).then(|| flat.as_chunks::<N>().0.to_vec())
}

/// The elements of an array of integers.
pub fn integers(value: Value) -> Option<Vec<i64>> {
    Some(match value {
        Value::IntVec(values) => values.into_iter().map(i64::from).collect(),
        Value::UintVec(values) => values.into_iter().map(i64::from).collect(),
        Value::Int64Vec(values) => values,
        _ => return None,
    })
}

/// The text of a token, or of a string: text layers do not tell which of the two metadata are.
pub fn name_of(value: Value) -> Option<String> {
    match value {
        Value::Token(name) => Some(name.to_string()),
        Value::String(name) => Some(name),
        _ => None,
    }
}
