//! CSV files with a line per user or sensor: what maps of gains and files of motion have in common.

use firmware_core::channel::GroundNode;

use crate::HostMission;

/// Returns a reader of a file that must begin with this line.
///
/// # Errors
/// Returns one line that states what the first line is and what it must be.
pub(crate) fn reader<'a>(
    content: &'a [u8],
    header: &[&str; 5],
) -> Result<csv::Reader<&'a [u8]>, String> {
    let mut reader = csv::ReaderBuilder::new()
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(content);
    let first = reader.headers().map_err(|error| error.to_string())?;
    if first != header[..] {
        let first: String = first.iter().collect::<Vec<_>>().join(",");
        let shown: String = first.chars().take(60).collect();
        return Err(format!(
            "the first line is `{shown}`, but must be `{}`",
            header.join(",")
        ));
    }
    Ok(reader)
}

/// Returns the five values of a line.
///
/// # Errors
/// Returns one line that states how many there are.
pub(crate) fn values(row: &csv::StringRecord) -> Result<[&str; 5], String> {
    let cells: Vec<&str> = row.iter().collect();
    let count = cells.len();
    (cells.try_into()).map_err(|_| format!("has {count} values, but must have 5"))
}

/// Returns the node of a line: `user` or `sensor`, and its number.
///
/// # Errors
/// Returns one line that names the value and what is allowed.
pub(crate) fn node(kind: &str, index: &str, mission: &HostMission) -> Result<GroundNode, String> {
    let (count, of): (usize, fn(usize) -> GroundNode) = match kind {
        "user" => (mission.user_count(), GroundNode::User),
        "sensor" => (mission.sensor_count(), GroundNode::Sensor),
        _ => return Err(format!("node is `{kind}`, but must be user or sensor")),
    };
    let number: Option<usize> = index.parse().ok().filter(|&number| number < count);
    number.map(of).ok_or_else(|| {
        format!(
            "index is `{index}`, but must be from 0 to {}: the mission has {count} {kind}s",
            count - 1
        )
    })
}
