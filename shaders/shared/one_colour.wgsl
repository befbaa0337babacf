// Light is one colour: invocations side by side do red, green and blue.
alias Light = f32;

var<private> channel: u32;

fn light(colour: vec4<f32>) -> Light {
    return colour[channel];
}
