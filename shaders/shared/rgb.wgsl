// Light is red, green and blue together.
alias Light = vec3<f32>;

fn light(colour: vec4<f32>) -> Light {
    return colour.xyz;
}
