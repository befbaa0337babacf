//! Stages in WGSL: their text, their pipelines, their dispatches.

use wgpu::BindingResource;

use crate::error::Result;

use super::context::{Gpu, TABLE_WIDTH};

/// Invocations a workgroup, of all stages.
pub const WORKGROUP: u32 = 64;

/// A stage: its entry point is `main`.
pub struct Shader {
    pub name: &'static str,
    /// Tables that it reads, bound at 0, 1, ...; `name(i)` is texel i.
    pub tables: &'static [&'static str],
    /// The rest: constants, bindings after the tables, functions.
    pub text: &'static str,
}

/// All stages.
pub const SHADERS: &[&Shader] = &[&super::visibility::SHADER];

impl Shader {
    /// The whole WGSL: sizes that are declared in Rust, shared functions, tables, the stage.
    pub fn source(&self) -> String {
        let mut source = format!(
            "const WORKGROUP = {WORKGROUP}u;\nconst TABLE_WIDTH = {TABLE_WIDTH}u;\n{}",
            include_str!("../../../shaders/shared/invocation.wgsl")
        );
        for (binding, name) in self.tables.iter().enumerate() {
            let table = include_str!("../../../shaders/shared/table.wgsl");
            source += &table
                .replace("NAME", name)
                .replace("BINDING", &binding.to_string());
        }
        source + self.text
    }
}

/// A stage that is ready to run.
pub struct Pipeline {
    name: &'static str,
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
            pipeline,
        })
    }

    /// Records `invocations` of the stage, with `resources` bound at 0, 1, ...
    pub fn dispatch(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        resources: &[BindingResource],
        invocations: u32,
    ) {
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding,
                resource: resource.clone(),
            })
            .collect();
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        // Rows of workgroups, because one row is not long enough for all.
        let groups = invocations.div_ceil(WORKGROUP);
        let row = groups.min(gpu.device.limits().max_compute_workgroups_per_dimension);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.name),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        if row > 0 {
            pass.dispatch_workgroups(row, groups.div_ceil(row), 1);
        }
    }
}
