// g2o in C++: its own reader, start from the file or along a spanning tree, Gauss-Newton or Levenberg-Marquardt,
// CHOLMOD on blocks ordered by AMD. The pose with the lowest id is held.
#include <g2o/core/factory.h>
#include <g2o/core/optimization_algorithm_factory.h>
#include <g2o/core/sparse_optimizer.h>
#include <g2o/core/sparse_optimizer_terminate_action.h>

#include <algorithm>
#include <memory>

#include "driver.h"

G2O_USE_TYPE_GROUP(slam2d);
G2O_USE_TYPE_GROUP(slam3d);
G2O_USE_OPTIMIZATION_LIBRARY(cholmod);

int main(int, char** argv) {
  const Arguments arguments(argv);
  Record record(arguments.stem);
  g2o::SparseOptimizer optimizer;
  std::vector<int> ids;
  int iterations = 0;

  record.timed("load", [&] {
    g2o::OptimizationAlgorithmProperty property;
    const std::string name =
        std::string(arguments.has("GN") ? "gn" : "lm") + (arguments.space ? "_fix6_3_cholmod" : "_fix3_2_cholmod");
    optimizer.setAlgorithm(g2o::OptimizationAlgorithmFactory::instance()->construct(name, property));
    optimizer.load(arguments.graph.c_str());
    for (const auto& [id, vertex] : optimizer.vertices()) ids.push_back(id);
    std::sort(ids.begin(), ids.end());
    optimizer.vertex(ids.at(0))->setFixed(true);
  });
  record.timed("start", [&] {
    optimizer.initializeOptimization();
    if (arguments.has("spanning tree")) optimizer.computeInitialGuess();
  });
  auto stop = std::make_unique<g2o::SparseOptimizerTerminateAction>();
  record.timed("optimize", [&] {
    stop->setGainThreshold(arguments.tolerance);
    stop->setMaxIterations(arguments.max_iterations);
    optimizer.addPostIterationAction(stop.get());
    iterations = optimizer.optimize(arguments.max_iterations);
  });
  record.optimized();
  if (iterations < 1) return failed("g2o's optimization failed");
  for (const int id : ids) {
    std::vector<double> pose;
    optimizer.vertex(id)->getEstimateData(pose);
    record.pose(id, pose);
  }
  optimizer.computeActiveErrors();
  record.write(iterations, optimizer.activeChi2(), "g2o, which states no version");
  return 0;
}
