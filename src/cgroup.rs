//! What a container leaves of the memory: the limits of control groups, version 1 and 2.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Bytes that the control groups of this process still leave to it, under a root directory that is `/`;
/// `None` where there are none, or no limits.
pub fn left(root: &Path) -> Option<u64> {
    let text = read_to_string(root.join("proc/self/cgroup")).ok()?;
    let mounts = root.join("sys/fs/cgroup");
    // A line is "number:controllers:path"; version 2 has the number 0 and no controllers.
    let groups = text.lines().filter_map(|line| {
        let mut parts = line.splitn(3, ':');
        let (_, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
        let path = path.trim_start_matches('/');
        match controllers {
            "" => Some((mounts.clone(), path, VERSION_2)),
            _ if controllers.split(',').any(|c| c == "memory") => {
                Some((mounts.join("memory"), path, VERSION_1))
            }
            _ => None,
        }
    });
    groups
        .flat_map(|(mount, path, files)| {
            // Inside of a container the group may be mounted as the root: the path leads nowhere.
            let own = mount.join(path);
            let above: Vec<PathBuf> = own.ancestors().map(Path::to_owned).collect();
            let within = above.into_iter().take_while(move |a| a.starts_with(&mount));
            within.filter_map(move |group| left_in(&group, &files))
        })
        .min()
}

/// Names of files: limit and usage.
type Files = [&'static str; 2];
const VERSION_2: Files = ["memory.max", "memory.current"];
const VERSION_1: Files = ["memory.limit_in_bytes", "memory.usage_in_bytes"];

/// What is left in one group. What the system keeps of files, and would give back, is not used.
fn left_in(group: &Path, [limit, usage]: &Files) -> Option<u64> {
    let number = |name: &str| -> Option<u64> {
        let text = read_to_string(group.join(name)).ok()?;
        text.trim().parse().ok()
    };
    let used = number(usage)?;
    let stat = read_to_string(group.join("memory.stat")).unwrap_or_default();
    let cached = |name: &str| {
        let mut lines = stat.lines();
        lines.find_map(|line| line.strip_prefix(name)?.trim().parse::<u64>().ok())
    };
    let spare = cached("total_inactive_file ").or_else(|| cached("inactive_file "));
    Some(number(limit)?.saturating_sub(used.saturating_sub(spare.unwrap_or(0))))
}
