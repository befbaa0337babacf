//! Links for the lights that came so far, and the operator that they make.

use super::task::Task;
use super::work::{Bounced, Work};
use crate::error::Result;
use crate::links::{self, Accuracy, Kept, Links};
use crate::octree::Octree;
use crate::operator::{Fmm, GpuFmm};
use crate::passes::gpu::Gpu;
use crate::points::Surfels;

/// Links that are refined for one light after the other. On a device they stay until they change.
pub(super) struct Linked {
    kept: Kept,
    gpu: Option<Gpu>,
    on_device: Option<GpuFmm>,
}

impl Linked {
    /// Links for no light yet.
    pub fn none(octree: &Octree, surfels: &Surfels, gpu: Option<Gpu>) -> Linked {
        Linked::new(Kept::none(octree, surfels), gpu)
    }

    pub fn new(kept: Kept, gpu: Option<Gpu>) -> Linked {
        Linked {
            kept,
            gpu,
            on_device: None,
        }
    }

    /// The same at the same place, for no light.
    pub fn rough(&self, task: &Task) -> Linked {
        Linked::none(task.octree, task.surfels, self.gpu.clone())
    }

    pub fn is_none(&self) -> bool {
        self.kept.is_none()
    }

    pub fn kept(&self) -> &Kept {
        &self.kept
    }

    pub fn links(&self) -> &Links {
        &self.kept.links
    }

    /// Makes the links good enough for a light. Without tests all are found afresh, which takes
    /// next to no time.
    pub fn refine(&mut self, task: &Task, accuracy: &Accuracy, slack: f32) -> Result<()> {
        if refine(&mut self.kept, task, accuracy, slack)? {
            self.on_device = None;
        }
        Ok(())
    }

    /// The same as the next stage of the run.
    pub fn refine_in_stage(&mut self, task: &Task, accuracy: &Accuracy, slack: f32) -> Result<()> {
        let mut changed = true;
        task.stages.update(&mut self.kept, |kept| {
            changed = refine(kept, task, accuracy, slack)?;
            Ok(())
        })?;
        if changed {
            self.on_device = None;
        }
        Ok(())
    }

    /// Solves the radiosity equation with the links that there are.
    pub fn solve(&mut self, task: &Task, work: &Work) -> Result<Bounced> {
        let (surfels, octree, links) = (task.surfels, task.octree, &self.kept.links);
        let Some(gpu) = &self.gpu else {
            return work.solve_by_links(&Fmm::new(surfels, octree, links), task.progress);
        };
        let operator = match self.on_device.take() {
            Some(operator) => operator,
            None => GpuFmm::new(gpu, surfels, octree, links)?,
        };
        work.solve(self.on_device.insert(operator), task.progress)
    }
}

/// Tells whether any link has changed.
fn refine(kept: &mut Kept, task: &Task, accuracy: &Accuracy, slack: f32) -> Result<bool> {
    let (surfels, octree, progress) = (task.surfels, task.octree, task.progress);
    if task.untested {
        kept.links = links::build_open(surfels, octree, accuracy, progress)?;
        return Ok(true);
    }
    let visibility = task.visibility;
    let opened = kept.refine(surfels, octree, accuracy, slack, visibility, progress)?;
    Ok(opened > 0)
}
