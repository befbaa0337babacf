//! Stages in WGSL: their text, their pipelines, their dispatches.

use wgpu::BindingResource;

use crate::error::Result;
use crate::expansion::{coefficients, count};

use super::unroll::{derivatives, unroll};
use super::wgsl::KERNEL;
use super::{Gpu, TABLE_WIDTH};

/// Invocations a workgroup, of all stages.
pub const WORKGROUP: u32 = 64;

/// Where the part of the items that a dispatch works on is bound, and where it reports to.
pub(super) const RANGE_BINDING: u32 = 14;
pub(super) const REPORTS_BINDING: u32 = 15;

/// Highest order of expansions on the device.
pub const MAX_ORDER: usize = 6;
/// Stages do red, green and blue together up to this order, and one colour an invocation beyond:
/// three times as many coefficients at once take long to compile and no longer fit registers.
const RGB_ORDER: usize = 3;

/// A stage: its entry point is `main`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shader {
    pub name: &'static str,
    /// Tables that it reads, bound at 0, 1, ...; `name(i)` is texel i.
    pub tables: &'static [&'static str],
    /// Light that it reads or writes, bound after the tables: irradiance or expansions.
    pub vectors: &'static [&'static str],
    /// Shared texts that it needs.
    pub shared: &'static [&'static str],
    /// Invocations that work on an item together, as a part of a subgroup or a whole one.
    pub lanes: u32,
    /// The rest: constants, bindings after those, functions.
    pub text: &'static str,
    /// Order of the expansions that it calculates with.
    pub order: usize,
    /// Order of the expansions in memory, which may have more coefficients.
    pub full_order: usize,
}

impl Shader {
    /// The same stage on the first coefficients, up to `order`, of expansions of `full_order`.
    pub fn of_order(&self, order: usize, full_order: usize) -> Shader {
        Shader {
            order,
            full_order,
            ..*self
        }
    }

    /// Whether an invocation does one colour of an item.
    fn by_colour(&self) -> bool {
        self.order > RGB_ORDER
    }

    /// Invocations an item.
    fn invocations(&self) -> u32 {
        self.lanes * if self.by_colour() { 3 } else { 1 }
    }

    /// The whole WGSL: sizes that are declared in Rust, shared functions, tables, light, the stage.
    pub fn source(&self) -> String {
        let (order, name) = (self.order, self.name);
        let stride = coefficients(self.full_order);
        let invocations = self.invocations();
        let call = if self.lanes > 1 {
            format!("{name}(range.first + i, lane, lanes);")
        } else if self.by_colour() {
            format!("channel = i % 3u; {name}(range.first + i / 3u);")
        } else {
            format!("{name}(range.first + i);")
        };
        let mut source = format!(
            "const WORKGROUP = {WORKGROUP}u;\n\
             const TABLE_WIDTH = {TABLE_WIDTH}u;\n\
             const INVOCATIONS = {invocations}u;\n\
             const ORDER = {order}u;\n\
             const TERMS = {}u;\n\
             const STRIDE = {stride}u;\n\
             {}",
            count(order),
            include_str!("../../../shaders/shared/invocation.wgsl")
        );
        for (binding, name) in self.tables.iter().enumerate() {
            source += &include_str!("../../../shaders/shared/table.wgsl")
                .replace("NAME", name)
                .replace("BINDING", &binding.to_string());
        }
        if !self.vectors.is_empty() {
            source += match self.by_colour() {
                true => include_str!("../../../shaders/shared/one_colour.wgsl"),
                false => include_str!("../../../shaders/shared/rgb.wgsl"),
            };
        }
        let (place, value) = match self.by_colour() {
            true => ("[channel]", "value"),
            false => ("", "vec4(value, 0.0)"),
        };
        for (binding, &name) in (self.tables.len()..).zip(self.vectors) {
            let stride = if name == "irradiance" { 1 } else { stride };
            source += &include_str!("../../../shaders/shared/vectors.wgsl")
                .replace("NAME", name)
                .replace("BINDING", &binding.to_string())
                .replace("STRIDE", &format!("{stride}u"))
                .replace("PLACE", place)
                .replace("VALUE", value);
        }
        for text in self.shared {
            source += &unroll(text, order)
                .replace("RANGE_BINDING", &RANGE_BINDING.to_string())
                .replace("REPORTS_BINDING", &REPORTS_BINDING.to_string())
                .replace("CALL", &call);
        }
        if self.shared.contains(&KERNEL) {
            source += &derivatives(order + 2);
        }
        source + &unroll(self.text, order)
    }

    /// Makes a pipeline of it; what the device has to say against it is for the caller to watch.
    pub(super) fn compile(&self, device: &wgpu::Device) -> wgpu::ComputePipeline {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(self.name),
            source: wgpu::ShaderSource::Wgsl(self.source().into()),
        });
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(self.name),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: None,
        })
    }
}

/// A stage that is ready to run.
pub struct Pipeline {
    name: &'static str,
    /// Invocations an item.
    invocations: u32,
    pipeline: wgpu::ComputePipeline,
}

impl Pipeline {
    pub fn new(gpu: &Gpu, shader: &Shader) -> Result<Pipeline> {
        Ok(Pipeline {
            name: shader.name,
            invocations: shader.invocations(),
            pipeline: gpu.pipeline(shader)?,
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
        let groups = (items * self.invocations).div_ceil(WORKGROUP);
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
