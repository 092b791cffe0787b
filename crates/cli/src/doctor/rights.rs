//! Scheduling rights of the worker, compared with the config.

use joulebus_bus::{Rights, Scheduling, try_scheduling};

use super::{Check, Status};

/// Checks that the worker would be granted the CPUs, the priority and the locked memory of its
/// config.
pub(super) fn scheduling(asked: &Scheduling) -> Check {
    let name = "scheduling";
    let found = format!("{}; {}", request(asked), rights(&Rights::of_this_process()));
    let refused = match try_scheduling(asked) {
        Ok(refused) => refused,
        Err(error) => {
            let remedy = "raise the limit of processes (`ulimit -u`)";
            return Check::new(name, Status::Fail, format!("{found}; {error}"), remedy);
        }
    };
    if refused.is_empty() {
        return Check::ok(name, found);
    }
    let status = if asked.required { Status::Fail } else { Status::Warn };
    let remedies: Vec<String> = refused.iter().map(ToString::to_string).collect();
    Check::new(name, status, found, remedies.join("; "))
}

fn request(asked: &Scheduling) -> String {
    if asked.is_nothing() {
        return "[worker] requests nothing".to_owned();
    }
    let mut wishes = Vec::new();
    if !asked.cpus.is_empty() {
        wishes.push(format!("CPUs {:?}", asked.cpus));
    }
    if asked.priority > 0 {
        wishes.push(format!("SCHED_FIFO {}", asked.priority));
    }
    if asked.lock_memory {
        wishes.push("locked memory".to_owned());
    }
    format!("[worker] requests {}", wishes.join(", "))
}

fn rights(rights: &Rights) -> String {
    let priority = match (rights.may_take_any_priority, rights.priority_limit) {
        (true, _) => "any real-time priority".to_owned(),
        (false, None) => "any real-time priority".to_owned(),
        (false, Some(0)) => "no real-time priority".to_owned(),
        (false, Some(limit)) => format!("real-time priority up to {limit}"),
    };
    let memory = if rights.allow_locking() { "all memory locked" } else { "no locked memory" };
    format!("CPUs {:?}, {priority}, {memory} would be granted", rights.cpus)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_scheduling_fails_if_required_and_warns_otherwise() {
        // No machine has this CPU.
        let asked = |required| Scheduling { cpus: vec![1023], required, ..Scheduling::default() };
        for (required, status) in [(true, Status::Fail), (false, Status::Warn)] {
            let check = scheduling(&asked(required));
            assert_eq!(check.status, status, "{check:?}");
            assert!(check.remedy.contains("CPU 1023"), "{check:?}");
            assert!(check.remedy.contains("`worker.cpus`"), "{check:?}");
        }
        assert_eq!(scheduling(&Scheduling::default()).status, Status::Ok);
    }
}
