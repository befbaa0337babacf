//! Stages in WGSL: their text, their pipelines, their dispatches.

use wgpu::BindingResource;

use crate::error::Result;

use super::{Gpu, TABLE_WIDTH};

/// Invocations a workgroup, of all stages.
pub const WORKGROUP: u32 = 64;

/// Where the part of the items that a dispatch works on is bound, and where it reports to.
pub(super) const RANGE_BINDING: u32 = 14;
pub(super) const REPORTS_BINDING: u32 = 15;

/// A stage: its entry point is `main`.
pub struct Shader {
    pub name: &'static str,
    /// Tables that it reads, bound at 0, 1, ...; `name(i)` is texel i.
    pub tables: &'static [&'static str],
    /// Expansions that it reads or writes, bound after the tables.
    pub expansions: &'static [&'static str],
    /// Shared texts that it needs.
    pub shared: &'static [&'static str],
    /// Invocations an item.
    pub lanes: u32,
    /// The rest: constants, bindings after those, functions.
    pub text: &'static str,
}

impl Shader {
    /// The whole WGSL: sizes that are declared in Rust, shared functions, tables, expansions, the
    /// stage.
    pub fn source(&self) -> String {
        let mut source = format!(
            "const WORKGROUP = {WORKGROUP}u;\nconst LANES = {}u;\nconst TABLE_WIDTH = {TABLE_WIDTH}u;\n{}",
            self.lanes,
            include_str!("../../../shaders/shared/invocation.wgsl")
        );
        let table = include_str!("../../../shaders/shared/table.wgsl");
        let expansions = include_str!("../../../shaders/shared/expansions.wgsl");
        let tables = self.tables.iter().map(|name| (table, name));
        let bound = tables.chain(self.expansions.iter().map(|name| (expansions, name)));
        for (binding, (text, name)) in bound.enumerate() {
            source += &text
                .replace("NAME", name)
                .replace("BINDING", &binding.to_string());
        }
        for text in self.shared {
            source += &text
                .replace("RANGE_BINDING", &RANGE_BINDING.to_string())
                .replace("REPORTS_BINDING", &REPORTS_BINDING.to_string())
                .replace("STAGE", self.name);
        }
        source + self.text
    }
}

/// A stage that is ready to run.
pub struct Pipeline {
    name: &'static str,
    /// Items of a workgroup.
    items: u32,
    pipeline: wgpu::ComputePipeline,
}

impl Pipeline {
    pub fn new(gpu: &Gpu, shader: &Shader) -> Result<Pipeline> {
        let pipeline = gpu.watch(shader.name, || {
            let module = gpu
                .device
                .create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(shader.name),
                    source: wgpu::ShaderSource::Wgsl(shader.source().into()),
                });
            let descriptor = wgpu::ComputePipelineDescriptor {
                label: Some(shader.name),
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: Default::default(),
                cache: None,
            };
            Ok(gpu.device.create_compute_pipeline(&descriptor))
        })?;
        Ok(Pipeline {
            name: shader.name,
            items: WORKGROUP / shader.lanes,
            pipeline,
        })
    }

    /// Records the stage on so many items, with `resources` bound at 0, 1, ...; returns the number
    /// of workgroups.
    pub fn dispatch(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        resources: &[BindingResource],
        items: u32,
    ) -> u32 {
        let entries = (0..)
            .zip(resources.iter().cloned())
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource });
        self.dispatch_entries(gpu, encoder, &entries.collect::<Vec<_>>(), items)
    }

    pub(super) fn dispatch_entries(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        entries: &[wgpu::BindGroupEntry],
        items: u32,
    ) -> u32 {
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries,
        });
        // Rows of workgroups, because one row is not long enough for all.
        let groups = items.div_ceil(self.items);
        let row = groups.min(gpu.device.limits().max_compute_workgroups_per_dimension);
        let rows = groups.checked_div(row).map_or(0, |_| groups.div_ceil(row));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.name),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        if rows > 0 {
            pass.dispatch_workgroups(row, rows, 1);
        }
        row * rows
    }
}
