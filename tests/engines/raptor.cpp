/* The network of PX4's mc_raptor in RLtools: loads the archive of the first argument and prints actions of rows of 22 inputs,
 * from reset at each STEPS-th row. The types are those of the module's blob/policy.h, github.com/PX4/PX4-Autopilot. */
#include <cstdio>
#include <iostream>
#include <string>
#include <vector>

#include <rl_tools/operations/cpu.h>

#include <rl_tools/nn/layers/dense/operations_generic.h>
#include <rl_tools/nn/layers/gru/operations_generic.h>
#include <rl_tools/nn/layers/sample_and_squash/operations_generic.h>
#include <rl_tools/nn_models/mlp/operations_generic.h>
#include <rl_tools/nn_models/sequential/operations_generic.h>

#include <rl_tools/persist/backends/tar/operations_generic.h>

#include <rl_tools/nn/optimizers/adam/instance/persist.h>

#include <rl_tools/nn/layers/dense/persist.h>
#include <rl_tools/nn/layers/gru/persist.h>
#include <rl_tools/nn_models/sequential/persist.h>

namespace rlt = rl_tools;
namespace layers = rlt::nn::layers;
using Device = rlt::devices::DefaultCPU;
using Index = Device::index_t;
using Types = rlt::numeric_types::Policy<float>;
using Activation = rlt::nn::activation_functions::ActivationFunction;
constexpr Index STEPS = 10, INPUTS = 22, ACTIONS = 4, WIDTH = 16, LONGEST = 500;

template <Index OUTPUTS, Activation ACTIVATION>
using Dense = layers::dense::BindConfiguration<layers::dense::Configuration<Types, Index, OUTPUTS, ACTIVATION>>;
using Memory = layers::gru::BindConfiguration<
    layers::gru::Configuration<Types, Index, WIDTH, rlt::nn::parameters::groups::Normal, false>>;
template <typename LAYER, typename NEXT = rlt::nn_models::sequential::OutputModule>
using Module = rlt::nn_models::sequential::Module<LAYER, NEXT>;
using Layers = Module<Dense<WIDTH, Activation::RELU>, Module<Memory, Module<Dense<ACTIONS, Activation::IDENTITY>>>>;
using Policy = rlt::nn_models::sequential::Build<rlt::nn::capability::Forward<false, false>, Layers,
                                                 rlt::tensor::Shape<Index, LONGEST, 1, INPUTS>>;
template <Index WIDTH_OF_ROW>
using Row = rlt::Tensor<rlt::tensor::Specification<float, Index, rlt::tensor::Shape<Index, 1, WIDTH_OF_ROW>, false>>;
namespace tar = rlt::persist::backends::tar;

int main(int, char **arguments) {
    Device device;
    Device::SPEC::RANDOM::ENGINE<> random;
    Policy policy;
    Policy::State<false> state;
    Policy::Buffer<false> buffers;
    Row<INPUTS> input;
    Row<ACTIONS> output;
    rlt::Mode<rlt::mode::Evaluation<>> mode;
    rlt::malloc(device, policy);

    std::vector<char> content;
    FILE *file = fopen(arguments[1], "rb");
    for (int byte; (byte = fgetc(file)) != EOF;) content.push_back(static_cast<char>(byte));
    fclose(file);
    tar::ReaderGroup<tar::ReaderGroupSpecification<Index>> archive;
    archive.data = content.data();
    archive.size = content.size();
    auto actor = rlt::get_group(device, archive, "actor");
    rlt::load(device, policy, actor);

    float row[INPUTS], action[ACTIONS];
    for (Index number = 0; fread(row, sizeof row, 1, stdin) == 1; ++number) {
        if (number % STEPS == 0) rlt::reset(device, policy, state, random);
        for (Index i = 0; i < INPUTS; ++i) rlt::set(device, input, row[i], 0, i);
        rlt::evaluate_step(device, policy, input, state, output, buffers, random, mode);
        for (Index i = 0; i < ACTIONS; ++i) action[i] = rlt::get(device, output, 0, i);
        fwrite(action, sizeof action, 1, stdout);
    }
    return 0;
}
