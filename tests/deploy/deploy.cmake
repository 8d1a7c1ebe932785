# What deploy/ promises. Tests that need an engine, a cluster or root say so and count as skipped where they have none (exit
# status 77).
if(TARGET gleaner AND TARGET gleaner-coordinator AND TARGET gleaner-worker)
  find_program(GLEANER_PYTHON3 python3 PATHS /usr/bin NO_DEFAULT_PATH REQUIRED)  # Debian's, with its packages
  set(programs ${CMAKE_RUNTIME_OUTPUT_DIRECTORY})
  add_test(NAME deploy_manifests COMMAND ${GLEANER_PYTHON3} ${CMAKE_CURRENT_LIST_DIR}/manifests_test.py ${CMAKE_SOURCE_DIR}
                                         ${programs})
  set_tests_properties(deploy_manifests PROPERTIES LABELS deploy TIMEOUT 300)
  foreach(subject runtime_packages systemd slurm compose hosts)
    add_test(NAME deploy_${subject} COMMAND ${CMAKE_CURRENT_LIST_DIR}/${subject}.sh ${CMAKE_SOURCE_DIR} ${programs})
    set_tests_properties(deploy_${subject} PROPERTIES LABELS deploy SKIP_RETURN_CODE 77 TIMEOUT 3600)
  endforeach()
  # They measure time against leases, and take ports.
  set_tests_properties(deploy_slurm deploy_compose deploy_hosts PROPERTIES RUN_SERIAL ON)
endif()
