// Steps one model in several threads at a time, each with its own mjData and a thread pool in it.
//
//   thread_driver LIBRARY SCENE.xml STEPS
//
// Prints the number of contacts that were seen; fails if the threads do not come to the same bits.

#include <mujoco/mujoco.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <thread>
#include <vector>

int main(int argc, char** argv) {
  if (argc != 4) return 2;
  mj_loadPluginLibrary(argv[1]);
  char error[1000] = "";
  mjModel* model = mj_loadXML(argv[2], nullptr, error, sizeof(error));
  if (!model) {
    std::fprintf(stderr, "%s\n", error);
    return 3;
  }
  constexpr int kThreads = 2;
  std::vector<mjData*> data(kThreads);
  std::vector<long> contacts(kThreads, 0);
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; t++) {
    threads.emplace_back([&, t] {
      data[t] = mj_makeData(model);
      mju_threadpool(data[t], 2);
      for (int step = 0; step < std::atoi(argv[3]); step++) {
        mj_step(model, data[t]);
        contacts[t] += data[t]->ncon;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  const bool same = std::memcmp(data[0]->qpos, data[1]->qpos, model->nq * sizeof(mjtNum)) == 0 &&
                    std::memcmp(data[0]->qvel, data[1]->qvel, model->nv * sizeof(mjtNum)) == 0;
  std::printf("%ld\n", contacts[0]);
  for (mjData* each : data) mj_deleteData(each);
  mj_deleteModel(model);
  return same ? 0 : 4;
}
