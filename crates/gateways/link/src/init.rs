//! `joulebus link init`: writes the files of links between hosts, and their certificates.

use std::fmt;
use std::fs::{self, Permissions};
use std::io::Write as _;
use std::net::{IpAddr, Ipv6Addr};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use joulebus_files::WholeFolder;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use crate::arguments::InitArguments;
use crate::certificates::Authority;

const MAX_BYTES: u64 = 1 << 20;
/// The name of the authority's files.
const AUTHORITY: &str = "fleet-ca";

/// A host as the command line names it.
#[derive(Debug)]
struct Host<'a> {
    name: &'a str,
    address: &'a str,
}

impl<'a> Host<'a> {
    fn parse(text: &'a str) -> Result<Self, UsageError> {
        let (name, address) = text.split_once('=').unwrap_or((text, text));
        // A folder and files have this name, too: none that is hidden, or another one's.
        let is_own = !name.starts_with(AUTHORITY);
        let is_address = address.parse::<IpAddr>().is_ok() || is_host(address, 253);
        if !is_host(name, 64) || !is_own || !is_address {
            let what = format!(
                "{text:?} is no link: a name of 1 to 64 letters, digits and `-_.`, which does not begin with {AUTHORITY}, and, \
                 if others reach that host by another name or an IP address, =ADDRESS without a port"
            );
            return Err(UsageError(what));
        }
        Ok(Self { name, address })
    }

    /// The address that others connect to.
    fn endpoint(&self, port: u16) -> String {
        match self.address.parse::<Ipv6Addr>() {
            Ok(address) => format!("tls/[{address}]:{port}"),
            Err(_) => format!("tls/{}:{port}", self.address),
        }
    }
}

/// True if the text can be the name of a host, and of a file.
fn is_host(text: &str, most: usize) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let is_whole = (1..=most).contains(&text.len()) && !text.starts_with(['.', '-']);
    is_whole && text.bytes().all(allowed)
}

/// Report of `init`: the written files, and the next commands.
#[derive(Debug, Serialize)]
struct InitReport {
    folder: PathBuf,
    /// True if the authority is new.
    new_authority: bool,
    hosts: Vec<HostReport>,
    /// Lines that the worker's file lacks, because it was there before.
    add_to_worker: Option<String>,
}

#[derive(Debug, Serialize)]
struct HostReport {
    link: String,
    folder: PathBuf,
    address: String,
    /// False if the folder was there before: it is left as it is.
    written: bool,
    worker: bool,
}

pub(crate) fn run(args: &InitArguments, output: Output) -> anyhow::Result<Outcome> {
    let hosts: Vec<Host<'_>> =
        args.hosts.iter().map(|text| Host::parse(text)).collect::<Result<_, _>>()?;
    let (worker, others) = hosts.split_first().context("clap requires hosts")?;
    if let Some(twice) = others.iter().find(|host| {
        host.name == worker.name
            || others.iter().filter(|other| other.name == host.name).count() > 1
    }) {
        let what = format!("{:?} is named twice: every link needs a name of its own", twice.name);
        return Err(UsageError(what).into());
    }
    if !args.replace {
        connect_to(&worker.endpoint(args.port), &args.out, others)?;
    }
    let failed = || format!("cannot write into {}", args.out.display());
    let mut whole = WholeFolder::begin(&args.out).with_context(failed)?;
    let (authority, new_authority) = authority(&args.out, &mut whole)?;
    let mut reports = Vec::new();
    for host in &hosts {
        let folder = args.out.join(host.name);
        let is_worker = host.name == worker.name;
        let written = args.replace || !folder.join("link.toml").exists();
        if written {
            let text = match is_worker {
                true => worker_file(host, others, args.port),
                false => other_file(host, worker, args.port),
            };
            let identity = authority
                .sign(host.name, host.address, args.days)
                .with_context(|| format!("cannot make the certificate of {}", host.name))?;
            let below = Path::new(host.name);
            write(&mut whole, &below.join("fleet-ca.pem"), &authority.pem)?;
            write(&mut whole, &below.join(format!("{}.pem", host.name)), &identity.certificate)?;
            write(&mut whole, &below.join(format!("{}.key", host.name)), &identity.key)?;
            write(&mut whole, &below.join("link.toml"), &text)?;
        }
        let address = host.endpoint(args.port);
        let link = host.name.to_owned();
        reports.push(HostReport { link, folder, address, written, worker: is_worker });
    }
    whole.keep().with_context(failed)?;
    let new = others.iter().zip(&reports[1..]).filter(|(_, report)| report.written);
    let lines: String = new.map(|(host, _)| take(host)).collect();
    let add_to_worker = (!reports[0].written && !lines.is_empty()).then_some(lines);
    let folder = args.out.clone();
    output.report(&InitReport { folder, new_authority, hosts: reports, add_to_worker })?;
    Ok(Outcome::Done)
}

/// Refuses a new address of the worker's host while files from before name another one.
fn connect_to(endpoint: &str, folder: &Path, others: &[Host<'_>]) -> anyhow::Result<()> {
    for file in others.iter().map(|host| folder.join(host.name).join("link.toml")) {
        if file.exists() {
            let text = joulebus_files::read_to_string(&file, MAX_BYTES)
                .with_context(|| file.display().to_string())?;
            if !text.contains(&format!("{endpoint:?}")) {
                let what = format!(
                    "{} was there before, and does not connect to {endpoint}. Name the address and --port as \
                     before, or write all files and certificates anew with --replace",
                    file.display()
                );
                return Err(UsageError(what).into());
            }
        }
    }
    Ok(())
}

/// The authority of the folder, made if it has none.
fn authority(folder: &Path, whole: &mut WholeFolder) -> anyhow::Result<(Authority, bool)> {
    let (pem, key) = (folder.join("fleet-ca.pem"), folder.join("fleet-ca.key"));
    if !key.exists() && pem.exists() {
        bail!(
            "{} is missing beside {}: put it back to add hosts. A new authority would be none of those that hosts \
             have: for one, name another folder with --out",
            key.display(),
            pem.display()
        );
    }
    if !key.exists() {
        let (authority, key_pem) = Authority::make()?;
        write(whole, Path::new("fleet-ca.key"), &key_pem)?;
        write(whole, Path::new("fleet-ca.pem"), &authority.pem)?;
        return Ok((authority, true));
    }
    let text = joulebus_files::read_to_string(&pem, MAX_BYTES)
        .with_context(|| pem.display().to_string())?;
    let secret =
        joulebus_files::read_secret(&key, MAX_BYTES).with_context(|| key.display().to_string())?;
    let opened = Authority::open(text, &secret);
    Ok((opened.with_context(|| format!("{} is damaged", key.display()))?, false))
}

/// Writes a file that only its owner can read. Its new folder is its owner's alone, too.
fn write(whole: &mut WholeFolder, name: &Path, text: &str) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", name.display());
    let path = whole.path(name).with_context(failed)?;
    let folder = path.parent().unwrap_or(&path);
    fs::set_permissions(folder, Permissions::from_mode(0o700)).with_context(failed)?;
    joulebus_files::replace(&path, |mut file| file.write_all(text.as_bytes())).with_context(failed)
}

fn head(host: &Host<'_>, which: &str, network: &str) -> String {
    let name = host.name;
    format!(
        "# Written by `joulebus link init`: {which}. docs/reference/link-file.md explains every key.\n\n\
         name = \"{name}\"\n\n[network]\n{network}\n\n\
         [network.tls]\nca = \"fleet-ca.pem\"\ncertificate = \"{name}.pem\"\nkey = \"{name}.key\"\n"
    )
}

fn worker_file(host: &Host<'_>, others: &[Host<'_>], port: u16) -> String {
    let any = if host.address.parse::<Ipv6Addr>().is_ok() { "[::]" } else { "0.0.0.0" };
    let head = head(
        host,
        "the host of the worker, beside `joulebus run`",
        &format!("listen = [\"tls/{any}:{port}\"]"),
    );
    let takes: String = others.iter().map(take).collect();
    format!(
        "{head}\n# `robots = [\"0-9\"]` in a section allows only samples of these robots.\n{takes}"
    )
}

fn take(host: &Host<'_>) -> String {
    format!("[[worker.take]]\nfrom = \"{}\"\n", host.name)
}

fn other_file(host: &Host<'_>, worker: &Host<'_>, port: u16) -> String {
    let head = head(
        host,
        "a host without a worker, instead of `joulebus run`",
        &format!("connect = [\"{}\"]", worker.endpoint(port)),
    );
    let worker = worker.name;
    format!(
        "{head}\n# Samples that are published on this host go to the worker.\n[samples]\nto = \"{worker}\"\n\n\
         # What the worker writes is read on this host. `robots` leaves some \
         out.\n[follow]\nworker = \"{worker}\"\n"
    )
}

impl fmt::Display for InitReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let folder = self.folder.display();
        let state = if self.new_authority { "made" } else { "kept" };
        writeln!(out, "{state} the fleet's authority: {folder}/fleet-ca.key stays here")?;
        for host in &self.hosts {
            let (link, folder, address) = (&host.link, host.folder.display(), &host.address);
            let state = if host.written { "wrote" } else { "left as it was" };
            writeln!(out, "\n{link}: {state} {folder}")?;
            writeln!(out, "  copy it to that host   scp -r {folder} {link}:")?;
            let beside = if host.worker { "beside" } else { "instead of" };
            writeln!(out, "  check it there         joulebus link {link}/link.toml --check")?;
            writeln!(out, "  {beside:<10} the worker  joulebus link {link}/link.toml")?;
            if host.worker {
                writeln!(out, "  the others connect to  {address}")?;
            }
        }
        if let (Some(lines), Some(worker)) = (&self.add_to_worker, self.hosts.first()) {
            writeln!(out, "\nadd to {}/link.toml:\n{lines}", worker.folder.display())?;
        }
        writeln!(
            out,
            "\nEvery host needs the same config of the fleet: `--config FILE` of each program."
        )
    }
}
