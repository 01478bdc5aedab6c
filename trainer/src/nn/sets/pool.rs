//! Pooling of the sensors: their mean and their maximum, feature by feature.

use pulp::Arch;

use super::{batch::SetBatch, functions::vectorize};

/// Writes `[mean; maximum]` of each state's sensors into the columns from `column` on of its row of
/// `out`, whose rows are `stride` apart, and the sensor with each maximum into `largest`.
pub fn forward(
    arch: Arch,
    batch: &SetBatch,
    width: usize,
    sensors: &[f32],
    out: (&mut [f32], usize, usize),
    largest: &mut Vec<u32>,
) {
    let (out, stride, column) = out;
    largest.resize(batch.len() * width, 0);
    vectorize(
        arch,
        #[inline(always)]
        || {
            for state in 0..batch.len() {
                let range = batch.sensors_of(state);
                let row = &mut out[state * stride + column..state * stride + column + 2 * width];
                let (mean, maximum) = row.split_at_mut(width);
                let largest = &mut largest[state * width..(state + 1) * width];
                mean.fill(0.0);
                maximum.fill(f32::NEG_INFINITY);
                largest.fill(range.start as u32);
                let share = 1.0 / range.len() as f32;
                for sensor in range {
                    let row = &sensors[sensor * width..(sensor + 1) * width];
                    for i in 0..width {
                        mean[i] += row[i];
                        let larger = row[i] > maximum[i];
                        maximum[i] = if larger { row[i] } else { maximum[i] };
                        largest[i] = if larger { sensor as u32 } else { largest[i] };
                    }
                }
                mean.iter_mut().for_each(|mean| *mean *= share);
            }
        },
    );
}

/// Computes the gradient of the sensors from that of the pooled values, which are in the columns
/// from `column` on of rows that are `stride` apart.
pub fn backward(
    arch: Arch,
    batch: &SetBatch,
    width: usize,
    pooled: (&[f32], usize, usize),
    largest: &[u32],
    d_sensors: &mut [f32],
) {
    let (d_pooled, stride, column) = pooled;
    vectorize(
        arch,
        #[inline(always)]
        || {
            for state in 0..batch.len() {
                let range = batch.sensors_of(state);
                let row = &d_pooled[state * stride + column..state * stride + column + 2 * width];
                let (mean, maximum) = row.split_at(width);
                let share = 1.0 / range.len() as f32;
                for sensor in range {
                    let row = &mut d_sensors[sensor * width..(sensor + 1) * width];
                    for i in 0..width {
                        row[i] = mean[i] * share;
                    }
                }
                for i in 0..width {
                    let sensor = largest[state * width + i] as usize;
                    d_sensors[sensor * width + i] += maximum[i];
                }
            }
        },
    );
}
