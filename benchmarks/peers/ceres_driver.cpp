// Ceres in C++: start from the file, Levenberg-Marquardt or dogleg, CHOLMOD. Ceres has no reader and no pose-graph cost:
// both are below, in the residual of g2o, with automatic derivatives as in its own examples. The first pose is held.
//
//     r = L' e,  information = L L',  e = (translation, wrapped angle or quaternion vector part) of z^-1 X_i^-1 X_j
#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include <array>
#include <cmath>
#include <map>
#include <sstream>

#include "driver.h"

struct InThePlane {
  Eigen::Vector3d z;
  Eigen::Matrix3d W;  // L'

  template <typename T>
  bool operator()(const T* X, const T* Y, T* residual) const {
    const Eigen::Matrix<T, 2, 1> d(Y[0] - X[0], Y[1] - X[1]);
    const T angle = Y[2] - X[2] - z[2];
    const Eigen::Matrix<T, 2, 1> h = Eigen::Rotation2D<T>(-X[2]) * d - z.head<2>().cast<T>();
    Eigen::Matrix<T, 3, 1> e;
    e << Eigen::Rotation2Dd(-z[2]).toRotationMatrix().cast<T>() * h,
        angle - 2 * M_PI * ceres::floor((angle + M_PI) / (2 * M_PI));
    Eigen::Map<Eigen::Matrix<T, 3, 1>>{residual} = W.cast<T>() * e;
    return true;
  }
};

struct InSpace {
  Eigen::Vector3d z;
  Eigen::Quaterniond q;
  Eigen::Matrix<double, 6, 6> W;

  template <typename T>
  bool operator()(const T* X, const T* Y, T* residual) const {
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> tx(X), ty(Y);
    const Eigen::Map<const Eigen::Quaternion<T>> qx(X + 3), qy(Y + 3);
    const Eigen::Quaternion<T> back = q.conjugate().cast<T>(), turn = back * (qx.conjugate() * qy);
    Eigen::Matrix<T, 6, 1> e;
    e.template head<3>() = back * (qx.conjugate() * (ty - tx) - z.cast<T>());
    e.template tail<3>() = turn.w() < T(0) ? Eigen::Matrix<T, 3, 1>(-turn.vec()) : Eigen::Matrix<T, 3, 1>(turn.vec());
    Eigen::Map<Eigen::Matrix<T, 6, 1>>{residual} = W.cast<T>() * e;
    return true;
  }
};

// The upper triangle of the information, row by row, as L'.
template <int n>
Eigen::Matrix<double, n, n> root(std::istream& line) {
  Eigen::Matrix<double, n, n> information;
  for (int row = 0; row < n; ++row)
    for (int column = row; column < n; ++column) {
      line >> information(row, column);
      information(column, row) = information(row, column);
    }
  return information.llt().matrixU();
}

template <int n>
void read(std::istream& line, double* numbers) {
  for (int k = 0; k < n; ++k) line >> numbers[k];
}

void load(const std::string& path, std::map<int, std::array<double, 7>>& poses, ceres::Problem& problem) {
  std::ifstream file(path);
  auto* manifold = new ceres::ProductManifold<ceres::EuclideanManifold<3>, ceres::EigenQuaternionManifold>();
  for (std::string text, tag; std::getline(file, text);) {
    std::istringstream line(text);
    int i = 0, j = 0;
    line >> tag >> i;
    if (tag == "VERTEX_SE2") read<3>(line, poses[i].data());
    if (tag == "VERTEX_SE3:QUAT") read<7>(line, poses[i].data());
    if (tag == "EDGE_SE2") {
      InThePlane cost;
      line >> j;
      read<3>(line, cost.z.data());
      cost.W = root<3>(line);
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<InThePlane, 3, 3, 3>(new InThePlane(cost)), nullptr, poses.at(i).data(),
          poses.at(j).data());
    }
    if (tag == "EDGE_SE3:QUAT") {
      InSpace cost;
      line >> j;
      read<3>(line, cost.z.data());
      read<4>(line, cost.q.coeffs().data());
      cost.q.normalize();
      cost.W = root<6>(line);
      double *X = poses.at(i).data(), *Y = poses.at(j).data();
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<InSpace, 6, 7, 7>(new InSpace(cost)), nullptr, X, Y);
      problem.SetManifold(X, manifold);
      problem.SetManifold(Y, manifold);
    }
  }
  problem.SetParameterBlockConstant(poses.begin()->second.data());
}

int main(int, char** argv) {
  google::InitGoogleLogging(argv[0]);
  const Arguments arguments(argv);
  Record record(arguments.stem);
  std::map<int, std::array<double, 7>> poses;
  ceres::Problem problem;
  ceres::Solver::Summary summary;

  record.timed("load", [&] { load(arguments.graph, poses, problem); });
  record.timed("start", [] {});
  record.timed("optimize", [&] {
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
    options.trust_region_strategy_type = arguments.has("LM") ? ceres::LEVENBERG_MARQUARDT : ceres::DOGLEG;
    options.function_tolerance = arguments.tolerance;
    options.gradient_tolerance = options.parameter_tolerance = 1e-15;  // the cost alone decides, as elsewhere
    options.max_num_iterations = arguments.max_iterations;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    ceres::Solve(options, &problem, &summary);
  });
  record.optimized();
  if (!summary.IsSolutionUsable()) return failed(summary.message);
  const std::size_t numbers = arguments.space ? 7 : 3;
  for (const auto& [id, pose] : poses) record.pose(id, std::vector<double>(pose.begin(), pose.begin() + numbers));
  record.write(static_cast<int>(summary.num_successful_steps + summary.num_unsuccessful_steps) - 1,
               2 * summary.final_cost, "Ceres " CERES_VERSION_STRING);
  return 0;
}
