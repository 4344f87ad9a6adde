//! The demonstration on a cluster: a worker is killed while calibrations run, a server while the
//! training does. Its table must be that of one process with a data folder, to the last digit.

use super::process::{Flip, LOOK, until};
use anyhow::{Result, ensure};
use std::path::Path;
use std::time::{Duration, Instant};

pub(super) fn run(flip: &Flip, folder: &Path, arguments: &[String]) -> Result<()> {
    let began = Instant::now();
    let say = |what: &str| println!("{:6.1} s  {what}", began.elapsed().as_secs_f64());

    let mut demonstration = flip.demonstrate(arguments)?;
    // It makes the schema, which the others wait for.
    until(|| Ok(flip.asked(&["jobs"])?.is_some()), "the first server")?;
    let mut south = flip.server("south")?;
    let mut workers = [flip.worker("worker-1")?, flip.worker("worker-2")?];
    say("PostgreSQL, two servers with an emulated bench each, two workers");

    let running = |kind: &str| -> Result<Option<f64>> {
        let jobs = flip.asked(&["jobs", "--state", "running", "--kind", kind])?;
        let first = jobs.and_then(|page| page["items"].as_array()?.first().cloned());
        Ok(first.map(|job| job["progress"]["fraction"].as_f64().unwrap_or(0.0)))
    };
    let mut killed = (false, false);
    let document = loop {
        if let Some(status) = demonstration.child.try_wait()? {
            ensure!(status.success(), "the demonstration ended: {status}");
            break demonstration.said()?;
        }
        if !killed.0 && running("calibration")?.is_some() {
            // In the middle of something.
            std::thread::sleep(Duration::from_secs(2));
            workers[0].kill()?;
            workers[0] = flip.worker("worker-3")?;
            say("worker-1 was killed while a calibration ran; worker-3 takes its place");
            killed.0 = true;
        }
        if !killed.1 && running("training")?.is_some_and(|fraction| fraction > 0.1) {
            south.kill()?;
            say("the server south was killed while a training ran");
            until(|| Ok(flip.bench("south")?["served"] == false), "south to be missed")?;
            say("its bench is known to be without a process");
            south = flip.server("south")?;
            say("the server south is there again");
            killed.1 = true;
        }
        std::thread::sleep(LOOK);
    };
    ensure!(killed == (true, true), "the demonstration was over before all were killed");
    say("the demonstration ended");
    println!("\n{}", serde_json::to_string_pretty(&document["rows"])?);

    let alone = flip.alone(folder, arguments)?;
    for part in ["rows", "mean_abs_error_mg", "training"] {
        let (here, there) = (&document[part], &alone[part]);
        ensure!(here == there, "{part} differs: one process alone has\n{there:#}");
    }
    say("one process with a data folder: the same table to the last digit");
    for process in workers.iter_mut().chain([&mut south]) {
        process.end()?;
    }
    Ok(())
}
