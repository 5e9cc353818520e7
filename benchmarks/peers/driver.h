// The part that all drivers share: arguments, clocks of the stages, and the two files that a driver leaves.
//
//     driver GRAPH STEM VARIANT SPACE TOLERANCE MAX_ITERATIONS
//
// GRAPH      a g2o file
// STEM.json  processor time and wall clock of load, start and optimize, ms; iterations; cost; peak memory, MB; versions
// STEM.txt   a line for each pose, lowest id first: id and the numbers of a g2o file, x y angle or x y z qx qy qz qw
// SPACE      1 for poses in space, 0 for poses in the plane
// TOLERANCE  the optimization ends when the relative decrease of the cost is smaller
#pragma once

#include <ctime>

#include <fstream>
#include <iomanip>
#include <iostream>
#include <string>
#include <vector>

struct Arguments {
  std::string graph, stem, variant;
  bool space;
  double tolerance;
  int max_iterations;

  explicit Arguments(char** argv)
      : graph(argv[1]), stem(argv[2]), variant(argv[3]), space(argv[4][0] == '1'), tolerance(std::stod(argv[5])),
        max_iterations(std::stoi(argv[6])) {}

  bool has(const std::string& word) const { return variant.find(word) != std::string::npos; }
};

class Record {
 public:
  explicit Record(const std::string& stem) : json_(stem + ".json"), poses_(stem + ".txt") {
    poses_ << std::setprecision(17);
  }

  template <typename Stage>
  void timed(const std::string& name, Stage stage) {
    const double cpu = now(CLOCK_PROCESS_CPUTIME_ID), wall = now(CLOCK_MONOTONIC);
    stage();
    cpu_ += separator() + '"' + name + "\": " + std::to_string(now(CLOCK_PROCESS_CPUTIME_ID) - cpu);
    wall_ += separator() + '"' + name + "\": " + std::to_string(now(CLOCK_MONOTONIC) - wall);
    ++stages_;
  }

  void pose(int id, const std::vector<double>& numbers) {
    poses_ << id;
    for (const double number : numbers) poses_ << ' ' << number;
    poses_ << '\n';
  }

  void write(int iterations, double chi2, const std::string& version) {
    json_ << std::setprecision(17) << "{\"cpu\": {" << cpu_ << "}, \"wall\": {" << wall_ << "}, \"iterations\": "
          << iterations << ", \"cost\": " << chi2 << ", \"peak\": " << peak_
          << ", \"said\": {\"version\": \"" << version << tools() << "\"}}\n";
  }

  // Peak memory so far is that of the run; the poses that are written later add to it.
  void optimized() {
    std::ifstream status("/proc/self/status");
    for (std::string line; std::getline(status, line);)
      if (line.rfind("VmHWM:", 0) == 0) peak_ = std::stod(line.substr(6)) * 1024 / 1e6;
  }

 private:
  static double now(clockid_t clock) {
    timespec time;
    clock_gettime(clock, &time);
    return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
  }
  // Versions of what every driver is compiled with.
  static std::string tools() {
    std::string versions = std::string(", g++ ") + __VERSION__;
#ifdef EIGEN_WORLD_VERSION
    versions += ", Eigen " + std::to_string(EIGEN_WORLD_VERSION) + '.' + std::to_string(EIGEN_MAJOR_VERSION) + '.' +
                std::to_string(EIGEN_MINOR_VERSION);
#endif
    return versions;
  }
  std::string separator() const { return stages_ > 0 ? ", " : ""; }

  std::ofstream json_, poses_;
  std::string cpu_, wall_;
  double peak_ = 0;
  int stages_ = 0;
};

inline int failed(const std::string& why) {
  std::cerr << "Error: " << why << '\n';
  return 1;
}
