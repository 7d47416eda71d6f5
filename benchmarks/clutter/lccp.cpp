// SPDX-License-Identifier: Apache-2.0
// Split clusters of points by local convexity with PCL: pcl::LCCPSegmentation (Stein et al., Object Partitioning Using
// Local Convexity, CVPR 2014) on the supervoxels of each cluster alone.
//
// Reads scenes from standard input until its end: int32 n, float32 xyz[n][3] [m], int32 cluster[n] (1 and up).
// Writes for each scene: int32 label[n] (1 and up, 0 where the point has no supervoxel), float64 CPU time [ms].
// Arguments: edge of a voxel [m], distance of seeds [m], concavity that is tolerated [deg].

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <vector>

#include <pcl/point_types.h>
#include <pcl/segmentation/lccp_segmentation.h>
#include <pcl/segmentation/supervoxel_clustering.h>

using Point = pcl::PointXYZRGBA;

struct Settings {
  float voxel, seed, concavity;
};

// Label the points of one cluster; labels from `next` on, which grows.
static void split(const pcl::PointCloud<Point>::Ptr &cloud, const Settings &settings,
                  const std::vector<std::size_t> &index, std::vector<std::int32_t> &labels, std::int32_t &next) {
  pcl::SupervoxelClustering<Point> supervoxels(settings.voxel, settings.seed);
  supervoxels.setUseSingleCameraTransform(false);
  supervoxels.setInputCloud(cloud);
  supervoxels.setColorImportance(0.0f);
  supervoxels.setSpatialImportance(1.0f);
  supervoxels.setNormalImportance(4.0f);
  std::map<std::uint32_t, pcl::Supervoxel<Point>::Ptr> clusters;
  supervoxels.extract(clusters);
  std::multimap<std::uint32_t, std::uint32_t> neighbours;
  supervoxels.getSupervoxelAdjacency(neighbours);

  pcl::LCCPSegmentation<Point> lccp;
  lccp.setConcavityToleranceThreshold(settings.concavity);
  lccp.setSanityCheck(true);
  lccp.setSmoothnessCheck(true, settings.voxel, settings.seed, 0.1f);
  lccp.setKFactor(0);
  lccp.setMinSegmentSize(5);
  lccp.setInputSupervoxels(clusters, neighbours);
  lccp.segment();
  const auto labelled = supervoxels.getLabeledCloud();
  lccp.relabelCloud(*labelled);

  std::map<std::uint32_t, std::int32_t> names;
  for (std::size_t k = 0; k < index.size(); ++k) {
    const std::uint32_t label = labelled->points[k].label;
    if (label == 0) continue;
    auto found = names.find(label);
    if (found == names.end()) found = names.emplace(label, next++).first;
    labels[index[k]] = found->second;
  }
  if (names.empty()) {  // too small for a supervoxel: one object, as it came
    for (const std::size_t k : index) labels[k] = next;
    ++next;
  }
}

int main(int argc, char **argv) {
  if (argc != 4) return 2;
  const Settings settings{std::strtof(argv[1], nullptr), std::strtof(argv[2], nullptr), std::strtof(argv[3], nullptr)};
  std::int32_t n = 0;
  while (std::fread(&n, sizeof n, 1, stdin) == 1) {
    if (n < 0) return 1;
    std::vector<float> xyz(3 * static_cast<std::size_t>(n));
    std::vector<std::int32_t> clusters(n), labels(n, 0);
    if (std::fread(xyz.data(), sizeof(float), xyz.size(), stdin) != xyz.size()) return 1;
    if (std::fread(clusters.data(), sizeof(std::int32_t), clusters.size(), stdin) != clusters.size()) return 1;
    const std::clock_t start = std::clock();
    std::map<std::int32_t, std::vector<std::size_t>> members;
    for (std::size_t k = 0; k < clusters.size(); ++k) members[clusters[k]].push_back(k);
    std::int32_t next = 1;
    for (const auto &[name, index] : members) {
      pcl::PointCloud<Point>::Ptr cloud(new pcl::PointCloud<Point>);
      cloud->reserve(index.size());
      for (const std::size_t k : index) {
        Point point;
        point.x = xyz[3 * k], point.y = xyz[3 * k + 1], point.z = xyz[3 * k + 2], point.rgba = 0;
        cloud->push_back(point);
      }
      split(cloud, settings, index, labels, next);
    }
    const double ms = 1e3 * static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    std::fwrite(labels.data(), sizeof(std::int32_t), labels.size(), stdout);
    std::fwrite(&ms, sizeof ms, 1, stdout);
    std::fflush(stdout);
  }
  return 0;
}
